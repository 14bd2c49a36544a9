"""The nine lines of the first page do what it says."""

from pathlib import Path


def test_the_nine_lines_of_the_first_page_run(run_page):
    failures, tries = run_page(Path(__file__).parents[2] / "docs" / "index.md")
    assert failures == 0 and tries >= 11
