"""What `import residuum as rs` offers: every name is typed, documented with an example, and loaded only when it is used."""

import inspect
import subprocess
import sys

import pytest

import residuum as rs

HEAVY = (
    "numpy",
    "scipy",
    "sympy",
    "numba",
    "pint",
    "sklearn",
    "fastapi",
    "pandas",
    "xarray",
    "plotly",
)
ERRORS = {"BadInput", "BadModel", "BadRecord", "BadUnit", "NotIdentifiable", "MissingPackage"}
FUNCTIONS = {
    name: getattr(rs, name) for name in rs.__all__ if inspect.isfunction(getattr(rs, name))
} | {"control.design": rs.control.design}
CLASSES = [name for name in rs.__all__ if inspect.isclass(getattr(rs, name)) and name not in ERRORS]


def public_methods(kind):
    return [
        (name, member)
        for name, member in vars(kind).items()
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, property))
    ]


def is_typed(function):
    signature = inspect.signature(function)
    parameters = [p for p in signature.parameters.values() if p.name != "self"]
    return signature.return_annotation is not inspect.Signature.empty and all(
        p.annotation is not inspect.Parameter.empty for p in parameters
    )


def test_importing_loads_nothing_heavy():
    script = f"import sys, residuum; print([name for name in {HEAVY!r} if name in sys.modules])"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def test_every_name_is_there_and_listed():
    assert set(rs.__all__) <= set(dir(rs))
    for name in rs.__all__:
        assert getattr(rs, name) is getattr(rs, name)
    with pytest.raises(
        AttributeError, match=r"no attribute 'reed'; did you mean 'read'. it has .*read"
    ):
        rs.reed  # noqa: B018


def test_type_checkers_see_what_is_loaded():
    source = inspect.getsource(rs)
    declared = source[source.index("if TYPE_CHECKING:") : source.index("__all__")]
    missing = [name for name in rs.__all__ if name not in declared.replace(",", " ").split()]
    assert missing == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_typed_and_documented(name):
    function = FUNCTIONS[name]
    assert is_typed(function)
    doc = inspect.getdoc(function)
    assert all(
        f"{section}\n---" in doc for section in ("Parameters", "Returns", "Raises", "Examples")
    )
    signature = inspect.signature(function)
    undocumented = [parameter for parameter in signature.parameters if parameter not in doc]
    assert undocumented == []


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_has_an_example_and_typed_documented_members(name):
    kind = getattr(rs, name)
    doc = inspect.getdoc(kind)
    assert "Examples\n---" in doc and ">>> import residuum as rs" in doc
    for member_name, member in public_methods(kind):
        function = member.fget if isinstance(member, property) else member
        assert inspect.getdoc(member), f"{name}.{member_name} says nothing"
        assert is_typed(function), f"{name}.{member_name} is not typed"
        parameters = [
            p
            for p in inspect.signature(function).parameters
            if p not in ("self", "settings", "options")
        ]
        unsaid = [p for p in parameters if p not in inspect.getdoc(member)]
        assert unsaid == [], f"{name}.{member_name} does not say what {unsaid} is"


@pytest.mark.parametrize("name", sorted(ERRORS))
def test_an_error_shows_when_it_comes(name):
    assert "Traceback" in inspect.getdoc(getattr(rs, name))


def test_a_function_without_an_own_example_points_to_one():
    for function in FUNCTIONS.values():
        doc = inspect.getdoc(function)
        if ">>>" not in doc:
            pointed = doc.rsplit("See `", 1)[1].split("`")[0]
            assert ">>> import residuum as rs" in inspect.getdoc(getattr(rs, pointed))
