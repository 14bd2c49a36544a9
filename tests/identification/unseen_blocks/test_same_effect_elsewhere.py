"""An effect that leads is fitted fully at its other places, too: neighbours show it nearly alike."""

from benchmarks.published_models import hidden_record, model_of
from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.following import followed
from residuum.identification.unseen_blocks.multiple_shooting import first_fit
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.search import related
from residuum.identification.unseen_blocks.trial_fits import full_fit, quick_fit, refined
from residuum.identification.unseen_blocks.tried import Wanted, begun


def test_the_store_of_the_rooms_is_not_left_to_the_floor():
    found = begun(first_fit(matched(model_of("heat-pump"), [hidden_record("heat-pump")], None)))
    validation, base = found.validation, found.base
    along = followed(base.model, validation.data, base.errors, validation.last)
    rooms, floor = (
        quick_fit(base.structure, Key("second-heat-store", place), along, validation)
        for place in ("rooms", "floor")
    )
    first = full_fit(refined(floor), validation)
    more = related(found, {first.keys: first}, [rooms, floor])
    assert more[rooms.keys].cost < first.cost


def test_a_store_is_sought_at_its_other_places_from_what_it_holds_at_its_own():
    """From first values of its own that of the rooms ended at a sixteenth of its capacity, and was taken for the floor's."""
    found = searched(
        model_of("heat-pump"),
        [hidden_record("heat-pump", 5)],
        None,
        Wanted(("second-heat-store", "radiation"), held=False),
    )
    assert found.best.keys == (Key("second-heat-store", "rooms"),)
    (store,) = found.best.model.effects
    assert abs(store.parameters["C_2"].value - 4e6) < 3e5
