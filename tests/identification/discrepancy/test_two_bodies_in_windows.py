"""Elasticity and play of a controlled axis, which is judged in windows; the machine is integrated here, in fine Euler steps."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from residuum.identification.physics import Key, read_model
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Conditions
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.multiple_shooting import first_fit_at_likelier_timing
from residuum.identification.unseen_blocks.scale import plain
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.tried import begun

AXIS = Path(__file__).with_name("axis.yaml").read_text()
SAMPLE_TIME, FINE, NOISE = 0.002, 80, 2e-5


def axis(play, k=4.0e4, d=60.0, seed=2, n=6000):
    """Two bodies of 20 kg, a spring between them that acts beyond `play`; a controller moves the first to and fro."""
    rng = np.random.default_rng(seed)
    wanted = np.convolve(
        np.repeat(rng.uniform(-0.2, 0.2, n // 300 + 1), 300)[:n], np.full(150, 1 / 150), mode="same"
    )
    q = v = far = w = 0.0
    F, Q = np.empty(n), np.empty(n)
    h = SAMPLE_TIME / FINE
    for i in range(n):
        Q[i] = q + NOISE * rng.standard_normal()
        F[i] = np.clip(2.0e4 * (wanted[i] - q) - 9e2 * v, -500.0, 500.0)
        for _ in range(FINE):
            twist = q - far
            held = twist - np.clip(twist, -play / 2, play / 2)
            contact = k * held + d * (v - w) if held or not play else 0.0
            v += h * (F[i] - 57.0 * v - contact) / 20.0
            w += h * contact / 20.0
            q += h * v
            far += h * w
    return Record({"force": F, "position": Q}, {"force": "N", "position": "m"}, SAMPLE_TIME)


def fitted(record, *effect):
    start = first_fit_at_likelier_timing(matched(read_model(AXIS, "axis.yaml"), [record], None))
    validation = replace(
        begun(start).validation, last=start.data.horizon(9), scale=plain(start.data)
    )
    model = start.found.model.with_effect(*effect)
    return validation.validate(
        Structure((Key(*effect[:2]),), model, start.structure.states, {}),
        steps=40,
        tolerance=1e-7,
    )


def test_the_far_body_swings_on_where_a_window_begins():
    """Settled at the beginning of every window, it would be estimated many standard deviations off, the noise never reached."""
    found = fitted(
        axis(0.0), "elastic-transmission", "slide", {"k": 3.0e4, "d": 50.0, "share": 0.4}
    )
    values = {n.partition(".")[2]: v for n, v in found.model.values.items() if "@" in n}
    assert values == {
        "k": pytest.approx(4.0e4, rel=0.01),
        "d": pytest.approx(60.0, rel=0.1),
        "share": pytest.approx(0.5, rel=0.01),
    }
    assert found.rms[0] < 1.2 * NOISE


def test_play_whose_contact_is_begun_too_stiff_is_found():
    found = fitted(
        axis(2e-3), "backlash", "slide", {"gap": 1e-3, "k": 2.5e5, "d": 500.0, "share": 0.6}
    )
    assert found.model.values["backlash@slide.gap"] == pytest.approx(2e-3, rel=0.05)


def test_a_spring_so_soft_that_no_window_sees_it_swing_is_not_told_from_a_load():
    """Its far body begins anywhere in every window: an unknown force and its slope, which explain whatever is missing."""
    window = Conditions(SAMPLE_TIME, duration=0.5, magnitude=1.0, storage=20.0)
    values = {"d": 0.0, "share": 0.5}
    for effect in (EFFECTS["elastic-transmission"], EFFECTS["backlash"]):
        assert effect.shows(values | {"k": 2.0e3}, window)  # .44 s
        assert not effect.shows(values | {"k": 1.0e3}, window)  # .63 s
        assert not effect.shows(values | {"k": 2.0e3, "d": 1.0e3}, window)  # creeps back in .5 s
