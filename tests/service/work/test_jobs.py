"""Jobs run in processes of their own, tell how far they are, and end when they are told to."""

import importlib
import os
import signal
import time

import pytest
from structlog.testing import capture_logs

from residuum.service.store import NotFound
from residuum.service.work.jobs import OVER, Jobs, JobState, TooManyJobs

WORK = """
import os, time
from types import SimpleNamespace
from residuum.identification.errors import BadInput
from residuum.identification.physics.effects import EFFECTS

def count(progress, upto):
    for number in range(upto):
        progress(number / upto, f"at {number}")
    return {"counted": upto, "process": os.getpid()}

def refuse(progress):
    raise BadInput("record a.csv, row 3: is empty;\\nmust hold a number")

def fail(progress):
    return {"never": 1 / 0}

def define(progress):
    before = "of-one-job" in EFFECTS
    EFFECTS.use_here(SimpleNamespace(id="of-one-job"))
    return {"before": before, "after": "of-one-job" in EFFECTS, "process": os.getpid()}

def wait(progress):
    progress(0.5, f"waiting in {os.getpid()}")
    time.sleep(600)
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    folder = tmp_path_factory.mktemp("work")
    (folder / "residuum_job_work.py").write_text(WORK)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        yield importlib.import_module("residuum_job_work")


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def jobs(told):
    jobs = Jobs(lambda kind, payload: told.append(payload), at_once=2, queued=3)
    yield jobs
    jobs.close()


def until(jobs, job, reached, seconds=120):
    end = time.monotonic() + seconds
    while not reached(jobs.get(job.id)):
        assert time.monotonic() < end, jobs.get(job.id)
        time.sleep(0.01)
    return jobs.get(job.id)


def over(job):
    return job.state in OVER


def test_a_job_reports_progress_and_its_result_from_another_process(jobs, work, told):
    done = until(jobs, jobs.submit("count", work.count, 20), over)
    assert (done.state, done.result["counted"], done.progress) == (JobState.DONE, 20, 1.0)
    assert done.result["process"] != os.getpid()
    shares = [each["progress"] for each in told if each["id"] == done.id]
    assert shares == sorted(shares) and len(shares) > 10
    again = until(jobs, jobs.submit("count", work.count, 2), over)
    assert again.result["process"] == done.result["process"], "the worker stays warm"


def test_effects_that_one_job_defines_are_not_the_next_one_s(jobs, work):
    first, second = (until(jobs, jobs.submit("define", work.define), over).result for _ in range(2))
    assert first == second == {"before": False, "after": True, "process": first["process"]}


def test_bad_input_is_refused_in_one_line_and_a_fault_of_ours_is_told_apart(jobs, work):
    refused = until(jobs, jobs.submit("refuse", work.refuse), over)
    assert (refused.state, refused.error) == (
        JobState.REFUSED,
        "record a.csv, row 3: is empty; must hold a number",
    )
    failed = until(jobs, jobs.submit("fail", work.fail), over)
    assert (failed.state, failed.error) == (JobState.FAILED, "ZeroDivisionError: division by zero")


def test_cancelling_ends_the_process_and_frees_its_place(jobs, work):
    waiting = [jobs.submit("wait", work.wait) for _ in range(2)]
    started = [until(jobs, job, lambda job: job.doing.startswith("waiting in")) for job in waiting]
    queued = jobs.submit("count", work.count, 3)
    assert jobs.get(queued.id).state is JobState.QUEUED
    process = int(started[0].doing.split()[-1])
    assert jobs.cancel(waiting[0].id).state is JobState.CANCELLED
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert until(jobs, queued, over).state is JobState.DONE
    os.kill(int(started[1].doing.split()[-1]), signal.SIGKILL)
    assert until(jobs, waiting[1], over).state is JobState.FAILED
    assert until(jobs, jobs.submit("count", work.count, 1), over).state is JobState.DONE
    assert jobs.cancel(queued.id).state is JobState.DONE


def test_a_job_that_is_cancelled_ends_without_a_word_in_the_log(jobs, work):
    with capture_logs() as lines:
        left = [jobs.submit("wait", work.wait) for _ in range(2)]
        for job in left:
            until(jobs, job, lambda job: job.doing.startswith("waiting in"))
            jobs.cancel(job.id)
        # each has the place of one that was cancelled
        for after in [jobs.submit("count", work.count, 1) for _ in range(2)]:
            assert until(jobs, after, over).state is JobState.DONE
        assert lines == []
        until(jobs, jobs.submit("fail", work.fail), over)
        while not lines:
            time.sleep(0.01)
    assert [line["event"] for line in lines] == ["job failed"]


def test_the_last_that_is_told_of_a_job_is_how_it_ended(jobs, work, told):
    ended = [jobs.submit("count", work.count, 200) for _ in range(2)]
    for job in ended:
        until(jobs, job, lambda job: job.progress > 0)
        jobs.cancel(job.id)
    assert until(jobs, jobs.submit("count", work.count, 1), over).state is JobState.DONE
    for job in ended:
        states = [each["state"] for each in told if each["id"] == job.id]
        assert states[-1] in OVER and not set(states[:-1]) & set(OVER)


def test_the_queue_is_bounded(jobs, work):
    running = [jobs.submit("wait", work.wait) for _ in range(5)]
    with pytest.raises(TooManyJobs, match="try again later"):
        jobs.submit("wait", work.wait)
    for job in running:
        jobs.cancel(job.id)
    with pytest.raises(NotFound, match="none of this name"):
        jobs.get("nothing")


def test_work_that_cannot_travel_fails_and_leaves_nothing_running(jobs, work):
    failed = until(jobs, jobs.submit("count", work.count, lambda: None), over)
    assert failed.state is JobState.FAILED and "lambda" in failed.error
    assert until(jobs, jobs.submit("count", work.count, 1), over).state is JobState.DONE
