"""`--plot` draws an answer as an image or a page, `report` writes a page that can be sent."""

import json
import sys

import numpy as np
import pytest
from scipy.signal import lfilter

import residuum as rs
from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.service.cli import ANSWER_IS_NO, BAD_INPUT, DONE, run

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("pictures")
    rs.simulate("linear-axis", duration=4.0, seed=1).save(place / "axis.csv")
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 6)
    y = lfilter([0.0, 0.4], [1.0, -0.8], u) + rng.normal(0.0, 0.05, 600)
    rs.from_arrays({"u": u, "y": y}, units={"u": "V", "y": "V"}, sample_time=0.1).save(
        place / "plant.csv"
    )
    rs.Record(**vars_of(Bearing.examples()[0].faulty[1])).save(place / "bearing.npz")
    return place


def vars_of(record):
    return {name: getattr(record, name) for name in ("channels", "units", "sample_time", "source")}


PLANT = "--input u --output y --method oe --order 1 --delay 1"
DRAWN = {
    "compare": ("compare linear-axis axis.csv", DONE, "velocity"),
    "explain": (
        "explain linear-axis axis.csv --effects viscous-friction",
        DONE,
        "What linear-axis lacks",
    ),
    "improve": (
        "improve linear-axis axis.csv --add viscous-friction --out better.yaml",
        DONE,
        "viscous-friction",
    ),
    "identify": (f"identify plant.csv {PLANT} --out plant.json", DONE, "response"),
    "score": (
        "score bearing bearing.npz --orders bpfi=5.4152,bpfo=3.5848",
        ANSWER_IS_NO,
        "indicators over their thresholds",
    ),
    "control": (
        "control design plant.json --structure pi --out controller.json",
        DONE,
        "step of the reference",
    ),
}


@pytest.mark.parametrize("answer", DRAWN)
def test_an_answer_is_drawn_as_an_image_and_as_a_page_of_its_own(
    answer, folder, monkeypatch, capsys
):
    monkeypatch.chdir(folder)
    if answer == "control":
        assert run(DRAWN["identify"][0].split()) == DONE
        capsys.readouterr()
    line, status, shown = DRAWN[answer]
    ending = "png" if answer in ("compare", "score") else "html"
    assert run([*line.split(), "--plot", f"{answer}.{ending}", "--json"]) == status
    assert json.loads(capsys.readouterr().out)["plot"] == f"{answer}.{ending}"
    content = (folder / f"{answer}.{ending}").read_bytes()
    if ending == "png":
        assert content.startswith(PNG) and len(content) > 10_000
    else:
        page = content.decode()
        assert shown in page and "Plotly.newPlot" in page and "<script src=" not in page


@pytest.mark.parametrize(
    ("file", "says"),
    [
        ("a.pgn", "did you mean '.png'? known are .png, .html"),
        ("nowhere/a.png", "folder 'nowhere' does not exist"),
    ],
)
def test_a_picture_that_could_not_be_written_is_refused_before_the_work(
    file, says, folder, monkeypatch, capsys
):
    monkeypatch.chdir(folder)
    assert run(["compare", "linear-axis", "axis.csv", "--plot", file]) == BAD_INPUT
    assert says in capsys.readouterr().err


def test_without_matplotlib_an_image_is_refused_with_the_way_on(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert run(["compare", "linear-axis", "axis.csv", "--plot", "a.png"]) == BAD_INPUT
    assert capsys.readouterr().err == (
        "residuum: a PNG image needs the package 'matplotlib': pip install 'residuum[plots]'\n"
    )


def test_a_report_is_one_page_without_scripts_that_holds_the_answer_and_the_record(
    folder, monkeypatch, capsys
):
    monkeypatch.chdir(folder)
    assert run(["report", "linear-axis", "axis.csv", "--out", "axis.html", "--json"]) == DONE
    assert json.loads(capsys.readouterr().out) == {
        "file": "axis.html",
        "model": "linear-axis",
        "records": ["axis.csv"],
    }
    page = (folder / "axis.html").read_text(encoding="utf-8")
    assert "structured error" in page and page.count("<svg") == 2 and "error of velocity" in page
    assert "<script" not in page and "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert run(["report", "axis.csv", "plant.csv", "--out", "both.html"]) == DONE
    assert (folder / "both.html").read_text(encoding="utf-8").count("<svg") == 2


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("report oven --out a.html", "names no record"),
        ("report axis.csv --explain --out a.html", "--explain needs a model"),
        (
            "report ovn.yaml axis.csv --out a.html",
            "model 'ovn.yaml': no such file; did you mean 'oven'?",
        ),
    ],
)
def test_a_report_of_nothing_is_refused(line, says, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert run(line.split()) == BAD_INPUT
    assert says in capsys.readouterr().err
