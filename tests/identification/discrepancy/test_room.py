"""What the search for missing physics holds its sources to: short files, numbers in its policy, no effect by name."""

import ast
import io
import tokenize
from pathlib import Path

import pytest

from residuum.identification import discrepancy, unseen_blocks
from residuum.identification.discrepancy import policy
from residuum.identification.physics.effects import EFFECTS, STRUCTURAL

ROOM = Path(discrepancy.__file__).parent
ON_BLOCKS = Path(unseen_blocks.__file__).parent
POLICY = [Path(policy.__file__), ON_BLOCKS / "policy.py"]
SEARCH = [
    file
    for file in [*sorted(ROOM.rglob("*.py")), *sorted(ON_BLOCKS.rglob("*.py"))]
    if file not in POLICY
]
MOST_LINES = 400
NO_CODE = (
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.COMMENT,
    tokenize.ENDMARKER,
)


def code_lines(file):
    """Lines that hold code: a docstring or a comment that says why makes no file too long."""
    text = file.read_text()
    tree = ast.parse(text)
    written = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in (
            tokenize.NL,
            tokenize.NEWLINE,
            tokenize.INDENT,
            tokenize.DEDENT,
            tokenize.COMMENT,
            tokenize.ENDMARKER,
        ):
            written.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and ast.get_docstring(node) is not None
        ):
            written -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(written)


def own_numbers(tree):
    """Names that a module gives to numbers, or to tables of them; functions in a table have numbers of their own."""
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            inside = list(ast.walk(node.value))
            numbers = [
                n for n in inside if isinstance(n, ast.Constant) and type(n.value) in (int, float)
            ]
            if numbers and not any(isinstance(n, ast.Lambda) for n in inside):
                yield ast.unparse(node)


def undocumented(tree):
    """Constants of a policy without a docstring of their own."""
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        told = (
            isinstance(after, ast.Expr)
            and isinstance(after.value, ast.Constant)
            and isinstance(after.value.value, str)
        )
        if isinstance(node, ast.Assign | ast.AnnAssign) and not told:
            yield ast.unparse(node)


@pytest.mark.parametrize(
    "file", [*SEARCH, *POLICY], ids=lambda file: f"{file.parent.name}/{file.stem}"
)
def test_a_file_is_short(file):
    assert code_lines(file) <= MOST_LINES


@pytest.mark.parametrize("file", SEARCH, ids=lambda file: f"{file.parent.name}/{file.stem}")
def test_numbers_stand_in_the_policy(file):
    assert list(own_numbers(ast.parse(file.read_text()))) == []


@pytest.mark.parametrize("file", POLICY, ids=lambda file: f"{file.parent.name}/{file.stem}")
def test_every_number_of_the_policy_says_what_it_is(file):
    assert list(undocumented(ast.parse(file.read_text()))) == []


@pytest.mark.parametrize("files", [POLICY[:-1], POLICY[-1:]], ids=["discrepancy", "unseen_blocks"])
def test_a_name_of_a_policy_has_one_value(files):
    named = [
        name.id
        for file in files
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        for name in ast.walk(target)
        if isinstance(name, ast.Name)
    ]
    assert sorted(named) == sorted(set(named))


@pytest.mark.parametrize("file", SEARCH, ids=lambda file: f"{file.parent.name}/{file.stem}")
def test_the_search_knows_no_effect_by_name(file):
    texts = {
        n.value
        for n in ast.walk(ast.parse(file.read_text()))
        if isinstance(n, ast.Constant) and isinstance(n.value, str)
    }
    ids = {*EFFECTS, *STRUCTURAL}
    assert [text for text in texts if text.partition("@")[0] in ids] == []
