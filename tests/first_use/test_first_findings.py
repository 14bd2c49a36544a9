"""From a wheel in an empty environment to a finding of each machine of the demo: without it nothing else counts."""

MACHINES = ("gate-actuator", "gripping-pliers", "process-plant")


def test_each_machine_of_the_demo_is_judged_and_a_second_start_goes_on(demo):
    demo.start()
    for machine in MACHINES:
        demo.wait(f"{machine} is judged", lambda: demo.verdict(machine))  # noqa: B023
        assert demo.verdict(machine) == "healthy", demo.ask(f"/assets/{machine}")["last_finding"]
    windows = {machine: demo.ask(f"/assets/{machine}")["windows"] for machine in MACHINES}
    assert demo.interrupt() in (0, 130)
    demo.wait_until_nothing_runs()
    assert "Traceback" not in demo.log()

    demo.start()
    for machine in MACHINES:
        demo.wait(f"{machine} goes on", lambda: demo.state(machine)["windows_judged"] > 0)  # noqa: B023
        assert demo.ask(f"/assets/{machine}")["windows"] > windows[machine]
        assert len(demo.ask(f"/models/{machine}/versions")["items"]) == 1, (
            "trained again, though nothing had changed"
        )
    assert demo.interrupt() in (0, 130)
    demo.wait_until_nothing_runs()
    assert "Traceback" not in demo.log()
