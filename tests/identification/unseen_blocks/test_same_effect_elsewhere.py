"""An effect that leads is fitted fully at its other places, too: neighbours show it nearly alike."""

from benchmarks.published_models import hidden_record, model_of
from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.following import followed
from residuum.identification.unseen_blocks.multiple_shooting import first_fit
from residuum.identification.unseen_blocks.search import related
from residuum.identification.unseen_blocks.trial_fits import full_fit, quick_fit, refined
from residuum.identification.unseen_blocks.tried import begun


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
