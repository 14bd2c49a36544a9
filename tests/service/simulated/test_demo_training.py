"""What the demo's training is keyed by."""

from residuum.service.simulated.demo import Demo


def test_each_machine_of_the_demo_has_a_key_of_its_own_that_stays():
    demo = Demo()
    try:
        keys = [[demo.training_key(machine.asset) for machine in demo.machines] for _ in range(2)]
    finally:
        demo.stop()
    assert keys[0] == keys[1]
    assert len(set(keys[0])) == len(demo.machines) == 3
