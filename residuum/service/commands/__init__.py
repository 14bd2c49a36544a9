"""The commands of the console program: name → (module in this package, one line of help).

Each module holds `app`, a `typer.Typer` with the command (or its subcommands). Reports go out
through `residuum.service.commands.report`.
"""

import shlex

from residuum.identification.errors import as_texts

# Fields that no command but `inspect` takes: it writes them into the mapping that all others read
# by.
_OF_INSPECT = ("decimal", "time", "missing", "names")
# How a logger's file is read: one command, or a person, writes it into a mapping for all others.
_OF_MAPPINGS = ("duplicates", "reordered")


def as_option(field: str, value: object = None) -> str:
    """A field of a question as it is said on the command line, or how a file is read.

    >>> as_option("units", {"torque": "N*m"})
    "--unit 'torque=N*m'"
    >>> as_option("missing", ["OL", "-127"])
    '`residuum inspect FILE --missing OL --missing -127 --out FILE.mapping.yaml`'
    """
    if field in _OF_MAPPINGS and value is not None:
        return (
            f"`{field}: {value}` in the mapping that `residuum inspect FILE --out"
            " FILE.mapping.yaml` writes"
        )
    name, *inside = field.split(".")
    option = " ".join([f"--{'unit' if name == 'units' else name.replace('_', '-')}", *inside])
    if value is None or value is True:
        return option
    words = " ".join(f"{option} {shlex.quote(text)}" for text in as_texts(field, value))
    if field in _OF_INSPECT:
        return f"`residuum inspect FILE {words} --out FILE.mapping.yaml`"
    return words


# Names of modules, not modules: each is loaded when it is called, since SymPy alone costs a second
# (docs/decisions/0004).
COMMANDS: dict[str, tuple[str, str]] = {
    "serve": ("serve", "Run the service (with --demo: with its simulated machines)."),
    "keys": ("keys", "Make the API keys of a first start, and show them once."),
    "doctor": (
        "doctor",
        "Check the service's surroundings: database, blocks, disk, buses, keys, compiled code.",
    ),
    "watch": (
        "watch",
        "Connect and watch a machine: settings, register map, live signals, training.",
    ),
    "opcua": (
        "opcua",
        "Browse an OPC UA server into a node map, or save the certificate to trust.",
    ),
    "sparkplug": ("sparkplug", "Browse a Sparkplug B edge node into a metric map."),
    "backup": (
        "backup",
        "Write the database and the signals into one verified file. The service may be running.",
    ),
    "report": ("report_file", "Records, and a model beside them, as one page that can be sent."),
    "results": ("results", "Findings and windows as Parquet files, a machine's month as a page."),
    "restore": ("restore", "Bring a backup back into an empty data folder and database."),
    "gateway": ("gateway", "Read machines and send their windows to a service, by HTTP."),
    "set-aside": (
        "set_aside",
        "List windows that the service refused, write one into a file, or send them again.",
    ),
    "machine": ("machine", "Run one simulated machine on a real bus."),
    "simulate": ("simulate", "Write a record of a simulated machine, with effects and faults."),
    "fault": ("fault", "Switch a fault of a machine in a running demo."),
    "replay": ("replay", "Send a recording to a CAN bus or a Modbus server."),
    "inspect": (
        "inspect",
        "Show how a logger's file is understood, and write a mapping file for it.",
    ),
    "compare": ("compare", "Compare a model with records: where and how much does it fail?"),
    "explain": ("explain", "Which physical effect is missing in a model?"),
    "improve": ("improve", "Add effects to a model and re-estimate it."),
    "estimate": ("estimate", "Estimate the parameters of a model; its structure is not changed."),
    "export": ("export", "Write a model as C, Python, MATLAB, Modelica or an FMU."),
    "effects": ("effects", "List the catalogue of physical effects, or what fits a model."),
    "identify": ("identify", "Identify a linear model with its uncertainty from a record."),
    "uncertainty": ("uncertainty", "Bound the error of an identified model at every frequency."),
    "residual": ("residual", "Design a residual generator, or run one on a record."),
    "train": ("train", "Train a diagnoser on records."),
    "score": ("score", "Score records with a diagnoser."),
    "rescore": (
        "rescore",
        "Score every record of a folder, bucket or database, on all processors or a Dask cluster.",
    ),
    "reidentify": (
        "reidentify",
        "Identify a model of every record of a folder, bucket or database.",
    ),
    "control": ("control", "Design a robust controller from identified models."),
}

# Commands that there were: name → what to do instead.
FORMER = {
    "scorer": (
        "windows go to the service by HTTP, and it judges them: name it in the gateways' setting"
        " service_url, and give it more processes by its setting workers"
    )
}
