"""Running the code of a page."""

import doctest
import re

import pytest

from residuum.identification.physics.effects import EFFECTS


@pytest.fixture
def run_page(tmp_path, monkeypatch):
    """Run a page's `pycon` blocks in one go, in a folder of its own; gives (failures, tries). Added effects go again."""
    monkeypatch.chdir(tmp_path)

    def run(page):
        text = "\n".join(re.findall(r"```pycon\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL))
        runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
        runner.run(doctest.DocTestParser().get_doctest(text, {"__name__": "page"}, page.name, str(page), 0))
        return runner.failures, runner.tries

    yield run
    EFFECTS._added.clear()
    EFFECTS._fingerprints.clear()
