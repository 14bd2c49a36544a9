"""Every command line that a page shows is one that the program takes."""

import re
import shlex
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import pytest
from typer.main import get_command

from residuum.service.commands import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *(
        p
        for kind in ("tutorials", "how-to", "explanation")
        for p in (ROOT / "docs" / kind).glob("*.md")
    ),
]


@lru_cache
def command(name):
    return get_command(import_module(f"residuum.service.commands.{COMMANDS[name][0]}").app)


def shown(page):
    text = page.read_text(encoding="utf-8")
    blocks = "\n".join(re.findall(r"```(?:console|sh)?\n(.*?)```", text, re.DOTALL))
    lines = [line.strip().removeprefix("$ ") for line in blocks.splitlines()]
    inline = [
        code
        for code in re.findall(
            r"`(residuum [^`]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)
        )
        if "--" in code
    ]
    return [line.split("   #")[0] for line in [*lines, *inline] if line.startswith("residuum ")]


def refused(line):
    """What of a line the program does not know; empty when it knows all."""
    words = [word for word in shlex.split(line, comments=True)[1:] if word not in ("[--json]", "…")]
    if words[0] not in COMMANDS:
        return words[0]
    kind, rest = command(words[0]), words[1:]
    while getattr(kind, "commands", None) and rest and not rest[0].startswith("-"):
        if rest[0] not in kind.commands:
            return rest[0]
        kind, rest = kind.commands[rest[0]], rest[1:]
    known = {
        option
        for parameter in kind.params
        for option in (*parameter.opts, *parameter.secondary_opts)
    } | {"--help"}
    return " ".join(
        word
        for word in rest
        if word.strip("[]").startswith("--") and word.strip("[]").split("=")[0] not in known
    )


@pytest.mark.parametrize(
    "page", [page for page in PAGES if shown(page)], ids=lambda page: page.stem
)
def test_the_commands_of_a_page_exist_with_their_options(page):
    assert [f"{line}: {what}" for line in shown(page) if (what := refused(line))] == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_says_what_it_does(name):
    def silent(kind, path):
        own = [] if kind.help or getattr(kind, "commands", None) else [path]
        own += [
            f"{path} {p.opts[0]}"
            for p in kind.params
            if p.opts[0] != "--help" and not getattr(p, "help", None)
        ]
        return own + [
            line
            for sub, inner in getattr(kind, "commands", {}).items()
            for line in silent(inner, f"{path} {sub}")
        ]

    assert silent(command(name), name) == []
