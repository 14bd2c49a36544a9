"""Writes what follows from the code: the reference pages (effects, Python names, commands, settings, routes, schema of
model files), and the pictures of rooms in ARCHITECTURE.md.

python docs/make_reference.py            # writes docs/reference/
python docs/make_reference.py --check    # exit status 1 when a page is stale
"""

import ast
import inspect
import json
import re
import sys
import tempfile
from functools import cache
from importlib import import_module
from pathlib import Path

from typer.main import get_command

import residuum as rs
from residuum.identification.physics import candidates, read_model
from residuum.identification.physics.effects import EFFECTS, STRUCTURAL
from residuum.identification.physics.files.model_schema import model_schema
from residuum.service.app import create_app
from residuum.service.commands import COMMANDS
from residuum.service.settings import Settings

HERE = Path(__file__).parent / "reference"
WRITTEN = "<!-- Written by docs/make_reference.py from the code; change it there. -->\n\n"


def pages():
    """Text of every generated file, by its name."""
    return {
        "effects.md": effects_page(),
        "python.md": python_page(),
        "commands.md": commands_page(),
        "settings.md": settings_page(),
        "routes.md": routes_page(),
        "model-file.schema.json": json.dumps(model_schema(), indent=1, ensure_ascii=False) + "\n",
        "../../ARCHITECTURE.md": plan_page(),
    }


PLAN = HERE.parents[1] / "ARCHITECTURE.md"
PACKAGE = Path(rs.__file__).parent
PICTURES = {
    "rooms": [
        PACKAGE / name
        for name in ("library", "diagnosis", "robust_control", "simulation", "service")
    ]
    + sorted(path.parent for path in (PACKAGE / "identification").glob("*/__init__.py")),
    "the service": sorted(path.parent for path in (PACKAGE / "service").glob("*/__init__.py")),
}
"""Title of a picture → the folders that it draws."""


def plan_page():
    """ARCHITECTURE.md with its pictures drawn anew."""
    text = PLAN.read_text(encoding="utf-8")
    for title, folders in PICTURES.items():
        begin, end = f"<!-- picture of {title} -->\n", f"<!-- end of {title} -->"
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}{picture(folders)}{end}{rest.partition(end)[2]}"
    return text


def picture(folders):
    """Who imports whom, as a Mermaid flow chart; an arrow that follows from two others is left out."""
    direct = {folder: (imported(folder) & set(folders)) - {folder} for folder in folders}
    groups = in_circles(direct)
    below = {
        group: {
            other
            for folder in group
            for target in direct[folder]
            for other in groups
            if target in other
        }
        - {group}
        for group in groups
    }
    arrows = {
        (group, other)
        for group, others in below.items()
        for other in others
        if not any(other in reached(below, third) for third in others - {other})
    }
    named = {group: " + ".join(sorted(folder.name for folder in group)) for group in groups}
    lines = sorted(
        f"    {key(named[a])}[{named[a]}] --> {key(named[b])}[{named[b]}]" for a, b in arrows
    )
    alone = sorted(named[group] for group in groups if not any(group in arrow for arrow in arrows))
    return "\n".join(
        [
            "```mermaid",
            "flowchart TD",
            *lines,
            *(f"    {key(name)}[{name}]" for name in alone),
            "```",
            "",
        ]
    )


def key(name):
    """A node's name for Mermaid, which takes no space and no sign."""
    return re.sub(r"\W+", "_", name)


def imported(folder):
    """The folders of the package, each with those above it, whose modules are imported below this one."""
    names = set().union(*map(imports, folder.rglob("*.py")))
    places = {PACKAGE.parent.joinpath(*name.split(".")) for name in names}
    return {
        above for place in places for above in (place, *place.parents) if PACKAGE in above.parents
    }


@cache
def imports(path):
    """The names of modules, and of what is taken from them, that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return frozenset(names)


def in_circles(direct):
    """The folders, those that import each other in a circle together."""
    far = {folder: reached(direct, folder) for folder in direct}
    return {frozenset({a, *(b for b in direct if b in far[a] and a in far[b])}) for a in direct}


def reached(graph, start):
    """All that is imported from here, however far away."""
    found, waiting = set(), [start]
    while waiting:
        for target in graph[waiting.pop()] - found:
            found.add(target)
            waiting.append(target)
    return found


def effects_page():
    """Every effect with equation, place, parameters, units and source."""
    parts = [
        WRITTEN + "# Effects\n",
        "An effect is one more term in a balance, or one more stage on the path of an input or output. "
        "Units are shown for one example; an effect takes the units of the balance or signal where it stands.\n",
        "| effect | equation | acts on |\n|---|---|---|",
        *(
            f"| [`{e.id}`](#{e.id}) | {cell(e.equation)} | {', '.join(e.acts_on)} |"
            for e in EFFECTS.values()
        ),
        "",
        *map(effect_section, EFFECTS.values()),
        "## Effects that are tied to a signal\n",
        "These stand at `balance(signal)` or `balance(other balance)`: to what they are tied is found in the records.\n",
        "| effect | equation |\n|---|---|",
        *(f"| `{e.id}` | {cell(e.equation)} |" for e in STRUCTURAL.values()),
    ]
    return "\n".join(parts).rstrip() + "\n"


def effect_section(effect):
    """One effect."""
    model = read_model(effect.examples()[0].model)
    target = candidates(model, [effect.id])[0][1]
    parameters = effect.parameters(model.site(target, effect))
    rows = [f"| `{p.name}` | {p.unit or '–'} | {bounds(p)} | {p.meaning} |" for p in parameters]
    given = ", ".join(f"{p.name}: {{value: {p.value:g}}}" for p in parameters)
    return "\n".join(
        [
            f"## {effect.id}\n",
            f"**{effect.title}**: {cell(effect.equation)}\n",
            f"{paragraphs(inspect.getdoc(type(effect)))[0]}\n",
            f"Acts on: {', '.join(effect.acts_on)}. Needs: {', '.join(effect.needs) or 'nothing more'}. "
            f"Source: {effect.reference}.\n",
            "| parameter | unit (example) | bounds | meaning |\n|---|---|---|---|",
            *rows,
            "",
            "```yaml\neffects:",
            f"  - {{id: {effect.id}, {effect.place}: {target}, parameters: {{{given}}}}}\n```\n",
        ]
    )


def bounds(parameter):
    """The bounds in words."""
    low, high = parameter.lower, parameter.upper
    if low == -float("inf"):
        return "any" if high == float("inf") else f"≤ {high:g}"
    return f"≥ {low:g}" if high == float("inf") else f"{low:g} … {high:g}"


def cell(text):
    """A text inside a table: bars do not end its cell."""
    return "`" + text.replace("|", "∣") + "`"


def plain(text):
    """A sentence inside a table: bars do not end its cell, and what looks like a tag is none."""
    return " ".join(text.replace("|", "∣").replace("<", "&lt;").split())


def python_page():
    """Every public name with its signature and docstring."""
    parts = [
        WRITTEN + "# Python\n",
        "`import residuum as rs` gives these names. Each is loaded when it is first used.\n",
        "| name | what it is |\n|---|---|",
        *(
            f"| [`rs.{name}`](#{anchor(name)}) | {first_line(item)} |"
            for name, item in documented().items()
        ),
        "",
        *(name_section(name, item) for name, item in documented().items()),
    ]
    return "\n".join(parts).rstrip() + "\n"


def documented():
    """Public names, functions before classes before errors."""
    items = {name: getattr(rs, name) for name in rs.__all__ if name not in ("effects", "control")}
    items["control.design"] = rs.control.design
    items["effects"] = rs.effects

    def order(entry):
        name, item = entry
        return (
            inspect.isclass(item) + (inspect.isclass(item) and issubclass(item, Exception)),
            name,
        )

    return dict(sorted(items.items(), key=order))


def anchor(name):
    """The anchor of a name's heading; `model` and `Model` have different ones."""
    kind = "class" if inspect.isclass(documented()[name]) else "function"
    return f"{kind}-{name.replace('.', '-').lower()}"


def first_line(item):
    """The first sentence of its documentation."""
    return paragraphs(inspect.getdoc(item))[0].replace("|", "∣")


def paragraphs(text):
    """The paragraphs of a docstring, each as one line: where its lines end says nothing."""
    return [" ".join(part.split()) for part in text.strip().split("\n\n")]


def name_section(name, item):
    """Signature, docstring, and the members of a class."""
    parts = [f"## rs.{name} {{ #{anchor(name)} }}\n"]
    if inspect.isfunction(item):
        parts.append(f"```python\nrs.{name}{signature(item)}\n```\n")
    parts.append(f"```text\n{inspect.getdoc(item)}\n```\n")
    kind = item if inspect.isclass(item) else type(item)
    if not inspect.isfunction(item) and not issubclass(kind, Exception):
        parts += [member(name, member_name, value) for member_name, value in members(kind)]
    return "\n".join(parts)


def members(kind):
    """Public methods and properties that the library's own classes define, by name."""
    found = {}
    for base in reversed(kind.__mro__):
        if base.__module__.startswith(("residuum.library", "residuum.identification.record")):
            found |= {name: value for name, value in vars(base).items() if not name.startswith("_")}
    return sorted(
        (n, v) for n, v in found.items() if inspect.isfunction(v) or isinstance(v, property)
    )


def member(owner, name, value):
    """One method or property."""
    function = value.fget if isinstance(value, property) else value
    head = f".{name}" + ("" if isinstance(value, property) else signature(value))
    return f"### {owner}.{name}\n\n```python\n{head}\n```\n\n```text\n{inspect.getdoc(function)}\n```\n"


def signature(function):
    """The signature without module names."""
    text = str(inspect.signature(function)).replace("(self, ", "(").replace("(self)", "()")
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", text)
    return text.replace("pandas.DataFrame", "DataFrame").replace(
        "plotly.graph_objects.Figure", "Figure"
    )


def commands_page():
    """Every command with its arguments and options."""
    parts = [
        WRITTEN + "# Commands\n",
        "Every command prints a short report; most print one JSON object with `--json`.\n",
    ]
    parts += ["| command | what it does |\n|---|---|"]
    parts += [f"| [`residuum {name}`](#{name}) | {says} |" for name, (_, says) in COMMANDS.items()]
    for name, (module, says) in COMMANDS.items():
        command = get_command(import_module(f"residuum.service.commands.{module}").app)
        parts.append(f"\n## {name}\n\n{says}\n")
        for sub_name, sub in (getattr(command, "commands", None) or {"": command}).items():
            parts.append(usage(f"residuum {name} {sub_name}".strip(), sub))
    return "\n".join(parts).rstrip() + "\n"


def usage(name, command):
    """A command's arguments and options as tables."""
    arguments = [p.make_metavar_text for p in map(Shown, command.params) if p.argument]
    lines = [f"```text\n{' '.join([name, *arguments])}\n```\n"]
    lines += [part + "\n" for part in paragraphs(command.help or "") if part]
    rows = [f"| `{p.name}` | {p.help} |" for p in map(Shown, command.params) if p.name != "--help"]
    return "\n".join([*lines, "| argument or option | meaning |\n|---|---|", *rows, ""])


def settings_page():
    """Every setting with its default, the service's own first and then those of machines, sources, windows and alarms."""
    schema = Settings.model_json_schema()
    parts = [
        WRITTEN + "# Settings\n",
        "A settings file is YAML: one of these keys a line. `residuum serve --settings FILE` reads it, or the variable "
        "`RESIDUUM_SETTINGS` names it. The environment comes first: `RESIDUUM_PORT=9000`. Unknown keys are refused.\n",
        settings_table(schema),
        *(
            f"\n## {name}\n\n{part.get('description', '')}\n\n{settings_table(part)}"
            for name, part in schema["$defs"].items()
        ),
    ]
    return "\n".join(parts).rstrip() + "\n"


def settings_table(schema):
    """The keys of one object."""
    rows = [
        f"| `{name}` | {kind_of(key)} | {default_of(name, key, schema)} | {plain(key.get('description', 'see above'))} |"
        for name, key in schema.get("properties", {}).items()
    ]
    return "\n".join(["| key | value | default | meaning |\n|---|---|---|---|", *rows])


def kind_of(key):
    """What may stand there, in words."""
    if "$ref" in key:
        name = key["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    several = next((key[name] for name in ("anyOf", "allOf", "oneOf") if name in key), None)
    if several is not None:
        return " or ".join(
            dict.fromkeys(kind_of(one) for one in several if one.get("type") != "null")
        )
    if "const" in key:
        return f"`{key['const']}`"
    if "enum" in key:
        return ", ".join(f"`{value}`" for value in key["enum"])
    if key.get("type") == "array":
        return f"list of {kind_of(key.get('items', {}))}"
    return {"object": "names and values", "string": "text", "boolean": "true or false"}.get(
        key.get("type"), key.get("type", "text")
    )


def default_of(name, key, schema):
    """The default as it would be written."""
    if name in schema.get("required", []):
        return "needed"
    default = key.get("default")
    if default in (None, "", [], {}) or isinstance(default, dict):
        return "–"
    return f"`{str(default).lower() if isinstance(default, bool) else default}`"


def routes_page():
    """Every route of the HTTP interface in a line; `/openapi.json` of a running service has bodies and answers too."""
    with tempfile.TemporaryDirectory() as folder:
        described = create_app(Settings(data=folder)).openapi()
    rows = [
        f"| `{verb.upper()}` | `{path}` | {plain(first_sentence(route))} |"
        for path, routes in described["paths"].items()
        for verb, route in routes.items()
    ]
    parts = [
        WRITTEN + "# Routes\n",
        "The service describes bodies, parameters and answers of each route in `/openapi.json`. "
        "Errors are problem documents (RFC 9457).\n",
        "| method | path | what it does |\n|---|---|---|",
        *rows,
    ]
    return "\n".join(parts) + "\n"


def first_sentence(route):
    """The first paragraph of a route's description."""
    return paragraphs(route.get("description") or route.get("summary") or "")[0]


class Shown:
    """A parameter of a command as the page shows it."""

    def __init__(self, parameter):
        self.argument = parameter.param_type_name == "argument"
        metavar = parameter.metavar or parameter.name.upper()
        self.make_metavar_text = metavar
        options = " / ".join([*parameter.opts, *parameter.secondary_opts])
        self.name = metavar if self.argument else options
        self.help = (parameter.help or "").replace("\\[", "[").replace("|", "∣").replace(
            "\n", " "
        ) + said_default(parameter)


def said_default(parameter):
    """The default as a sentence, where there is one that the help does not tell itself."""
    default = parameter.default
    told = (
        isinstance(default, (str, int, float)) and not isinstance(default, bool) and default != ""
    )
    return f" Default: {default}." if told and "efault" not in (parameter.help or "") else ""


def main(arguments):
    """Write the pages, or tell which are stale."""
    stale = [
        name
        for name, text in pages().items()
        if not (HERE / name).is_file() or (HERE / name).read_text() != text
    ]
    if "--check" in arguments:
        sys.stderr.write(
            "".join(
                f"docs/reference/{name} is stale: python docs/make_reference.py\n" for name in stale
            )
        )
        return bool(stale)
    HERE.mkdir(exist_ok=True)
    for name, text in pages().items():
        (HERE / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
