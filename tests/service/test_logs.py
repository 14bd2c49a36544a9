"""Lines of the log go to standard error as it is when they come."""

import io
import logging
import sys

import pytest

from residuum.service.logs import set_up_logs
from residuum.service.settings import load_settings


@pytest.fixture
def kept_handlers():
    handlers = list(logging.root.handlers)
    yield
    logging.root.handlers[:] = handlers


def test_a_line_comes_out_though_standard_error_was_closed_meanwhile(
    tmp_path, monkeypatch, kept_handlers
):
    first, second = io.StringIO(), io.StringIO()
    set_up_logs(load_settings(data=tmp_path))
    monkeypatch.setattr(sys, "stderr", first)
    logging.getLogger("a library").warning("one")
    first_said = first.getvalue()
    monkeypatch.setattr(sys, "stderr", second)
    first.close()
    logging.getLogger("a library").warning("two")
    assert "one" in first_said and "two" in second.getvalue()
