"""The documentation: its code runs, its pages follow from the code, its site builds without a network."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import residuum as rs
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.files import model_file
from residuum.identification.physics.files.expression import FUNCTIONS
from residuum.identification.physics.files.model_schema import model_schema
from residuum.identification.physics.model import BALANCE_KINDS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
WRITTEN_BY_HAND = sorted(
    page for kind in ("tutorials", "how-to", "reference", "explanation") for page in (DOCS / kind).glob("*.md")
    if not page.read_text(encoding="utf-8").startswith("<!-- Written by")
)  # fmt: skip


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", DOCS / "index.md", *WRITTEN_BY_HAND], ids=lambda page: page.stem
)
def test_a_page_typed_in_an_empty_folder_does_what_it_shows(page, run_page):
    assert "\n".join(run_page(page)) == ""


@pytest.mark.parametrize(
    "text, failures",
    [
        ("```console\n$ echo speed 1.52 rad/s\nspeed 1.53 rad/s\n```\n", 0),
        ("```console\n$ echo speed 1.52 rad/s\nspeed 1.54 rad/s\n```\n", 1),
        ("```console\n$ printf '1 A\\n2 B\\n'\n1 A\n```\n", 1),
        ("```console\n$ printf '1 A\\n2 B\\n'\n1 A\n…\n```\n", 0),
        ("```sh\ncat healthy1.csv\n```\n", 1),
        ("<!-- not run: it needs a plant -->\n```sh\ncat healthy1.csv\n```\n", 0),
        ("<!-- not run: -->\n```sh\ncat healthy1.csv\n```\n", 1),
        ("<!-- file: healthy1.csv -->\n```text\ntime [s]\n```\n```sh\ncat healthy1.csv\n```\n", 0),
        ("```pycon\n>>> import pandas\n\n```\n", 1),
        ("`pip install residuum[notebook]`\n```pycon\n>>> import pandas\n\n```\n", 0),
        ("```sh\npython -c 'import pandas' || exit 7\n```\n", 1),
        ("Type\n\n    residuum serve\n", 1),
        ("```\nresiduum serve\n```\n", 1),
    ],
)
def test_a_page_that_cannot_be_typed_fails(text, failures, tmp_path, run_page):
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    assert len(run_page(page)) == failures


@pytest.mark.parametrize("page", WRITTEN_BY_HAND, ids=lambda page: page.stem)
def test_every_model_on_a_page_can_be_read(page):
    for text in blocks(page, "yaml"):
        if text.startswith("name:"):
            assert rs.model(text).outputs


def test_the_page_of_model_files_names_every_key_kind_role_and_function():
    text = (DOCS / "reference" / "model-files.md").read_text(encoding="utf-8")
    keys = {
        *model_file.KEYS,
        *model_file.INPUT_KEYS,
        *model_file.STATE_KEYS,
        *model_file.PARAMETER_KEYS,
    }
    keys |= {*model_file.OUTPUT_KEYS, *model_file.EFFECT_KEYS, "kind", "storage", "terms"}
    keys |= {*BALANCE_KINDS, *(role for _, roles in BALANCE_KINDS.values() for role in roles)}
    coded = set(re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)))
    assert [key for key in sorted(keys) if key not in coded] == []
    examples = "".join(blocks(DOCS / "reference" / "model-files.md", "yaml"))
    assert [name for name in FUNCTIONS if f"{name}(" not in examples] == []
    assert [
        name for name in FUNCTIONS if not any(word.startswith(f"{name}(") for word in coded)
    ] == []


def test_the_schema_takes_the_files_that_the_reader_takes():
    jsonschema = pytest.importorskip("jsonschema")
    import yaml

    check = jsonschema.Draft202012Validator(model_schema())
    texts = [rs.model(name).text for name in model_file.BUILT_IN]
    texts += [
        text
        for page in WRITTEN_BY_HAND
        for text in blocks(page, "yaml")
        if text.startswith("name:")
    ]
    for text in texts:
        assert list(check.iter_errors(yaml.safe_load(text))) == []
    broken = yaml.safe_load(texts[0]) | {"blances": {}}
    assert not check.is_valid(broken)


def test_the_written_pages_are_what_the_code_says():
    spec = importlib.util.spec_from_file_location("make_reference", DOCS / "make_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    stale = [
        n
        for n, text in module.pages().items()
        if (DOCS / "reference" / n).read_text(encoding="utf-8") != text
    ]
    assert stale == [], "run: python docs/make_reference.py"
    assert json.loads(module.pages()["model-file.schema.json"]) == model_schema()


def test_what_a_command_or_an_effect_does_is_told_to_the_end():
    for page in ("commands.md", "effects.md"):
        parts = (DOCS / "reference" / page).read_text(encoding="utf-8").split("\n```yaml\n")
        prose = [
            line
            for part in parts
            for line in part.splitlines()
            if line[:1].isupper() and not line.startswith("Acts on")
        ]
        assert [line for line in prose if line[-1] not in ".:?"] == []


def test_every_effect_has_equation_parameters_and_units():
    text = (DOCS / "reference" / "effects.md").read_text(encoding="utf-8")
    for effect in EFFECTS.values():
        section = text.split(f"\n## {effect.id}\n")[1].split("\n## ")[0]
        assert effect.equation.replace("|", "∣") in section and "| parameter | unit" in section


def test_the_site_is_built_and_fetches_nothing(tmp_path):
    pytest.importorskip("mkdocs")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        str(tmp_path / "site"),
    ]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    page = (tmp_path / "site" / "tutorials" / "first-hour.html").read_text(encoding="utf-8")
    fetched = re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=\"(https?://[^\"]+)\"", page)
    assert [address for address in fetched if "canonical" not in address] == []


def test_a_package_that_is_built_takes_the_pages_along(tmp_path):
    pytest.importorskip("mkdocs")
    clone, package = tmp_path / "clone", tmp_path / "package"
    (clone / "residuum" / "service" / "web").mkdir(parents=True)
    for name in ("docs", "mkdocs.yml", "setup.py", "README.md"):
        (clone / name).symlink_to(ROOT / name)
    # older setuptools know no licence expressions
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (clone / "pyproject.toml").write_text(
        re.sub("^license.*$", "", project, flags=re.MULTILINE), encoding="utf-8"
    )
    for folder in ("residuum", "residuum/service", "residuum/service/web"):
        (clone / folder / "__init__.py").touch()
    command = [sys.executable, "setup.py", "-q", "build_py", "--build-lib", str(package)]
    built = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    assert (
        "first hour"
        in (package / "residuum/service/web/site/tutorials/first-hour.html")
        .read_text(encoding="utf-8")
        .lower()
    )


@pytest.mark.parametrize(
    "page",
    [ROOT / "README.md", DOCS / "index.md", *(DOCS / "tutorials").glob("*.md")],
    ids=lambda p: p.stem,
)
def test_sentences_can_be_read_once(page):
    prose = re.sub(
        r"```.*?```|!\[.*?\]\(.*?\)", "", page.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    text = re.sub(r"^(\||    |#).*$", "", prose, flags=re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    paragraphs = re.split(r"\n\s*\n|\n\s*[*] ", text)
    sentences = [
        s
        for p in paragraphs
        for s in re.split(r"(?<=[.!?:])\s", p.replace("\n", " "))
        if len(s.split()) > 2
    ]
    assert sum(len(s.split()) for s in sentences) / len(sentences) <= 22
