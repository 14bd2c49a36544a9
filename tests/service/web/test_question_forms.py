"""The page's forms are drawn from the interface: a field that a question gets in Python is on the page with no script changed."""

import numpy as np
import pytest
from playwright.sync_api import expect
from scipy.signal import lfilter

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.record import Record
from residuum.library.questions import field
from residuum.library.questions.compare import Compare
from residuum.library.questions.control_design import DesignController
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.identify import Identify
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.service.api.analyses import Identification

SIZES = {"desk": (1280, 800), "phone": (390, 844)}
OF_THE_PAGE = {"records": "record"}
"""Fields that a page asks in a way of its own → what it calls them."""


@pytest.fixture(scope="module")
def service(run_service, no_machines, tmp_path_factory):
    service = run_service(no_machines)
    rng = np.random.default_rng(5)
    u = rng.normal(size=600)
    record = Record(
        {"u": u, "y": lfilter([0, 0.3], [1, -0.7], u), "z": u}, {"u": "V", "y": "m", "z": "m"}, 0.1
    )
    service.services.store.add_record("plant.csv", record)
    service.services.store.add_record("again.csv", record)
    file = tmp_path_factory.mktemp("models") / "plant.json"
    save_identified(identify_impulse_response(record, "u", "y", order=10, delay=1), file)
    service.services.store.add_model_version("plant", "identified", file.read_bytes())
    return service


class Wider(Identification):
    """The question with fields that the page has never heard of, one of each kind."""

    haste: str = field("calm", "How fast to look.", choices=("calm", "hurried"))
    tries: int = field(3, "How often to look [tries].", ge=1, le=9)
    share: float | None = field(
        None, "Share to look at; default: all.", gt=0, le=1, only_with=({"haste": ["hurried"]},)
    )
    twice: bool = field(False, "Look twice.")
    near: dict[str, float] | None = field(None, "Where to look.", example={"a": 1.0})
    span: tuple[float | None, float | None] | None = field(None, "From where to where.")
    names: list[str] | None = field(None, "What to look for.")


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_field_more_is_on_the_page_with_no_script_changed(service, open_page, legible, size):
    page = open_page(service.url, size=size, expected=["Failed to load"])

    def widened(route):
        document = service.app.openapi()
        schemas = document["components"]["schemas"] | {"Identification": Wider.model_json_schema()}
        route.fulfill(json=document | {"components": document["components"] | {"schemas": schemas}})

    page.route("**/openapi.json", widened)
    page.route("**/api/v1/identify", lambda route: route.abort())
    page.goto(f"{service.url}/#/identify")
    page.get_by_text("More options").click()
    expect(page.get_by_text("How fast to look.")).to_be_visible()
    legible(page)
    expect(page.get_by_label("haste")).to_have_value("calm")
    expect(page.get_by_label("tries [tries]")).to_have_value("3")
    expect(page.get_by_label("tries [tries]")).to_have_accessible_description(
        "How often to look [tries]."
    )
    expect(page.get_by_label("share")).to_be_hidden()
    page.get_by_label("haste").select_option("hurried")
    page.get_by_label("share").fill("0.5")
    page.get_by_label("tries [tries]").fill("10")
    assert not page.get_by_label("tries [tries]").evaluate("(input) => input.checkValidity()")
    page.get_by_label("tries [tries]").fill("4")
    page.get_by_label("twice").check()
    page.get_by_label("near").fill("a=2, b=3")
    page.get_by_label("span, upper").fill("7")
    page.get_by_label("names").fill("this, that")
    with page.expect_request("**/api/v1/identify") as sent:
        page.get_by_role("button", name="Identify").click()
    asked = sent.value.post_data_json
    more = {
        "haste": "hurried",
        "share": 0.5,
        "tries": 4,
        "twice": True,
        "near": {"a": 2, "b": 3},
        "names": ["this", "that"],
    }
    assert (
        asked.items()
        >= (more | {"span": [None, 7], "method": "kernel", "noise_variance": "marginal"}).items()
    )
    assert "share=0.5" in page.url and "kernel" not in page.url  # what differs from the defaults


def drawn(page, name):
    return page.locator(
        f"form [data-key={name}], form [data-key={name}-0], form [data-key^={name}-]"
    ).first


@pytest.mark.parametrize(
    ("address", "question"), [("identify", Identify), ("control", DesignController)]
)
def test_every_field_of_a_question_is_drawn_with_its_default(service, open_page, address, question):
    page = open_page(f"{service.url}/#/{address}")
    expect(page.get_by_text("More options").first).to_be_visible()
    all_are_drawn(page, question)


WORKBENCH = {"compare": Compare, "why": Explain, "add": Improve, "record": Estimate}
"""Step of the workbench → the question that it asks."""


@pytest.mark.parametrize("step", WORKBENCH)
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_every_option_is_on_the_steps_of_the_workbench(service, open_page, legible, step, size):
    page = open_page(service.url, size=size, expected=["Failed to load"])
    page.route(
        "**/models/gate-drive/*",
        lambda route: route.abort() if route.request.method == "POST" else route.continue_(),
    )
    shown = "%7B%22auto%22:true%7D" if step == "add" else "%7B%7D"
    page.goto(f"{service.url}/#/workbench?records=1&model=gate-drive&step={step}&shown={shown}")
    page.get_by_text("More options").click()
    legible(page)
    all_are_drawn(page, WORKBENCH[step])


def test_an_option_of_a_step_is_sent_and_kept_in_the_address(service, open_page):
    page = open_page(
        f"{service.url}/#/workbench?records=1&model=gate-drive", expected=["Failed to load"]
    )
    page.route("**/models/gate-drive/explain", lambda route: route.abort())
    page.get_by_role("tab", name="Why").click()
    page.get_by_text("More options").click()
    page.get_by_label("effects").fill("coulomb-friction, backlash")
    with page.expect_request("**/explain") as sent:
        page.get_by_label("effects").press("Enter")
    assert sent.value.post_data_json["effects"] == ["coulomb-friction", "backlash"]
    page.reload()
    expect(page.get_by_label("effects")).to_have_value("coulomb-friction, backlash")


def all_are_drawn(page, question):
    for name, declared in question.model_fields.items():
        place = drawn(page, OF_THE_PAGE.get(name, name))
        if name == "auto":
            continue  # it says what an empty `add` says already
        expect(place).to_be_attached()
        default = declared.default
        if isinstance(default, bool):
            assert place.is_checked() == default or name == "check"  # the page draws what it tells
        elif isinstance(default, str | int | float) and not declared.is_required():
            assert place.input_value() == (
                default if isinstance(default, str) else f"{default:.10g}"
            )


NODES = """streams:
  drive:
    sample_time: 0.1
    channels:
      speed: {node: "ns=2;s=Speed", unit: rpm}
"""


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_source_of_any_kind_is_described_by_its_own_settings(service, open_page, legible, size):
    page = open_page(service.url, size=size, expected=["Failed to load"])
    page.route("**/assets/press/machine", lambda route: route.abort())
    page.goto(f"{service.url}/#/watch")
    kinds = page.locator("[data-key=kind]")
    expect(kinds).to_be_visible()
    declared = service.app.openapi()["components"]["schemas"]["SourceSettings"]["properties"][
        "kind"
    ]["enum"]
    assert (
        kinds.locator("option").evaluate_all("(all) => all.map((each) => each.value)") == declared
    )
    described_by = page.locator("[data-key=described_by]")
    for kind in declared:
        kinds.select_option(kind)
        expect(page.get_by_label("host")).to_be_visible(visible=kind == "modbus")
        assert described_by.locator("option").count() == (2 if kind == "modbus" else 1)
        legible(page)
    kinds.select_option("opcua")
    page.locator("[data-key=name]").fill("press")
    page.get_by_label("channel").fill("opc.tcp://127.0.0.1:4840")
    file = {"name": "nodes.yaml", "mimeType": "application/yaml", "buffer": NODES.encode()}
    page.locator("[data-key=map-file]").set_input_files(file)
    expect(page.get_by_role("cell", name="speed")).to_be_visible()
    page.get_by_text("More options").click()
    offered = (
        page.get_by_label("diagnoser")
        .locator("option")
        .evaluate_all("(all) => all.map((each) => each.value)")
    )
    assert sorted(offered) == sorted(DIAGNOSERS)
    with page.expect_request("**/assets/press/machine") as sent:
        page.locator("[data-key=watch-machine]").click()
    asked = sent.value.post_data_json
    assert asked["sources"] == [
        {"kind": "opcua", "channel": "opc.tcp://127.0.0.1:4840", "map": "nodes.yaml"}
    ]
    assert asked["diagnoser"] == "model-based" and "Speed" in asked["maps"]["nodes.yaml"]
