"""What is found is a sentence, also where a window leaves the size of it open."""

from types import SimpleNamespace

from residuum.diagnosis.model_based.assessment import CauseSize, cause_sentence

LUGRE = SimpleNamespace(kind="effect", name="lugre-friction", place="shaft", unit="N*m")


def test_a_size_that_is_left_open_is_said_to_be_so():
    assert (
        cause_sentence(LUGRE, None, "")
        == "lugre friction of the shaft, of a size that the window leaves open"
    )


def test_a_size_stands_with_its_unit_and_what_is_usual():
    says = cause_sentence(
        LUGRE, CauseSize(0.75, 0.002, (0.44, 0.45)), ", since 3.2 s into the window"
    )
    assert (
        says
        == "lugre friction of the shaft 0.75 ± 0.0039 N*m, healthy 0.44 to 0.45, since 3.2 s into the window"
    )


def test_a_small_size_is_not_told_as_nothing():
    inertia = SimpleNamespace(kind="parameter", name="J", place="", unit="kg*m^2")
    says = cause_sentence(inertia, CauseSize(3.04e-6, 5e-8, (2.9e-6, 3.1e-6)), "")
    assert says == "J 3.04e-06 ± 9.8e-08 kg*m^2, healthy 2.9e-06 to 3.1e-06"
