"""Every fault that the demo offers is found once it is on and raises an alarm, which clears once it is off again."""

from concurrent.futures import ThreadPoolExecutor

MACHINES = ("gate-actuator", "gripping-pliers", "process-plant")
STANDING = {"unacknowledged", "acknowledged", "latched"}


def test_each_fault_is_found_raises_its_alarm_and_clears(demo):
    demo.start()
    with ThreadPoolExecutor(len(MACHINES)) as machines:  # side by side, as the machines live
        found = dict(
            zip(
                MACHINES,
                machines.map(lambda machine: _faults_found(demo, machine), MACHINES),
                strict=True,
            )
        )
    assert found["gate-actuator"] == ["gear-notch", "pinion-tooth", "rack-tooth"]
    assert found["gripping-pliers"] == ["plier-bearing"]
    assert found["process-plant"] == [
        "sensor-offset",
        "sensor-drift",
        "actuator-gain",
        "stuck-sensor",
    ]
    assert demo.interrupt() in (0, 130)
    demo.wait_until_nothing_runs()
    assert "Traceback" not in demo.log()


def _faults_found(demo, machine):
    demo.wait(f"{machine} is healthy", lambda: demo.verdict(machine) == "healthy")
    faults = [fault["id"] for fault in demo.ask(f"/demo/machines/{machine}/fault")["faults"]]
    for fault in faults:
        demo.command("fault", machine, fault)
        demo.wait(f"{fault} is found", lambda: demo.verdict(machine) == "faulty")
        demo.wait(f"{fault} raises an alarm", lambda: demo.alarms(machine) & STANDING)
        demo.command("fault", machine, "none")
        demo.wait(
            f"{machine} is healthy without {fault}", lambda: demo.verdict(machine) == "healthy"
        )
        demo.wait(f"the alarm of {fault} clears", lambda: not demo.alarms(machine) & STANDING)
    return faults
