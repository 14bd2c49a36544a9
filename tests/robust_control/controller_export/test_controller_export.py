"""Exported controllers compute what the design computes: compiled C, executed structured text, python-control."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import step_response
from residuum.robust_control.controller_export import DifferenceEquation, c_source, structured_text
from residuum.robust_control.synthesis.constrained_structure import PIDN

TS = 0.05
CONTROLLER = PIDN(TS).transfer_function(np.array([0.4, 0.7, 0.05, 0.2]))
LIMITED = DifferenceEquation(CONTROLLER, -1.0, 2.5)


def test_without_limits_the_equation_is_the_transfer_function():
    e = np.random.default_rng(0).normal(size=200)
    np.testing.assert_allclose(
        DifferenceEquation(CONTROLLER).run(e), CONTROLLER.simulate(e), rtol=1e-9, atol=1e-12
    )


def test_the_self_test_reaches_a_limit_and_leaves_it():
    _, u = LIMITED.self_test()
    assert u.max() == 2.5 and u.min() == -1.0 and abs(u[-1]) < 2.5


def test_saturation_does_not_wind_up():
    plant = TransferFunction([1.0], [2.0, 1.0]).discretise(TS)
    slow = TransferFunction([3.0, -2.7], [1.0, -1.0], TS)

    def response(equation):
        y, u, e = np.zeros(200), np.zeros(200), np.zeros(200)
        for k in range(1, 200):
            y[k] = -plant.den[1] * y[k - 1] + plant.num[0] * u[k - 1]
            e[k] = 1.0 - y[k]
            u[k] = equation.run(e[: k + 1])[-1]
        return y

    bounded = response(DifferenceEquation(slow, 0.0, 1.1))
    free = step_response(plant, slow, 10.0)
    assert free.max() > 1.2 and bounded.max() < 1.05 and bounded[-1] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    "equation", [LIMITED, DifferenceEquation(CONTROLLER)], ids=["limited", "free"]
)
def test_compiled_c_passes_its_self_test_and_a_wrong_coefficient_fails_it(equation, tmp_path):
    if (cc := shutil.which("cc")) is None:
        pytest.skip("no C compiler here")
    source = c_source(equation)
    wrong = source.replace("controller_b[i] *", "1.001 * controller_b[i] *")
    for text, passes in ((source, True), (wrong, False)):
        (tmp_path / "k.c").write_text(text, encoding="utf-8")
        command = [
            cc,
            "-std=c99",
            "-DCONTROLLER_SELF_TEST",
            "-Wall",
            "-Wextra",
            "-Werror",
            "-pedantic",
            "k.c",
            "-o",
            "k",
            "-lm",
        ]
        subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
        assert (subprocess.run([tmp_path / "k"], check=False, timeout=60).returncode == 0) is passes


def executed(source, block, **inputs):
    """Run a function block's structured text by translating its few statements to Python."""
    text = re.search(rf"FUNCTION_BLOCK {block}\n(.*?)END_FUNCTION_BLOCK", source, re.DOTALL)[1]
    body, depth, lines = text[text.rindex("END_VAR") + 7 :], 0, []
    for raw in body.strip().splitlines():
        line = raw.strip().rstrip(";")
        if line.startswith("END_"):
            depth -= 1
            continue
        opens = line.startswith(("FOR ", "IF "))
        line = re.sub(
            r"FOR (\w+) := (\w+) TO (\w+) BY -1 DO", r"for \1 in range(\2, \3 - 1, -1):", line
        )
        line = re.sub(r"FOR (\w+) := (\w+) TO (\w+) DO", r"for \1 in range(\2, \3 + 1):", line)
        line = re.sub(r"IF (.*) THEN", r"if \1:", line).replace(":=", "=")
        lines.append("    " * depth + line.replace("RETURN", "raise StopIteration"))
        depth += opens
    memory = dict(inputs)
    for name, values in re.findall(r"(\w+) : ARRAY\[\d+\.\.\d+\] OF LREAL := \[(.*?)\];", text):
        memory[name] = [float(v) for v in values.split(", ")]
    memory |= {"e": [0.0] * len(memory["b"]), "u": [0.0] * len(memory["b"]), "MAX": max, "MIN": min}
    return compile("\n".join(lines), block, "exec"), memory


def test_structured_text_computes_the_same():
    code, memory = executed(structured_text(LIMITED), "RobustController", Reset=False)
    e, expected = LIMITED.self_test()
    found = []
    for value in e:
        memory["Error"] = value
        exec(code, memory)
        found.append(memory["Output"])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_literals_carry_a_decimal_point_and_the_test_vector_is_there():
    source = structured_text(LIMITED)
    assert (
        not re.search(r"[\[ ]-?\d+e", source)
        and "Expected : ARRAY[1..24]" in source
        and "every T#50ms" in source
    )


def test_python_control_gets_the_same_system():
    pytest.importorskip("control")
    z = np.exp(1j * np.array([0.1, 1.0]) * TS)
    np.testing.assert_allclose(
        CONTROLLER.to_control()(z), CONTROLLER.frequency_response([0.1, 1.0]), rtol=1e-9
    )


def test_what_cannot_be_exported_is_refused():
    with pytest.raises(BadInput, match="discrete-time and proper"):
        DifferenceEquation(TransferFunction([1.0], [1.0, 1.0]))
    with pytest.raises(BadInput, match="lower must be below"):
        DifferenceEquation(CONTROLLER, 1.0, 1.0)
