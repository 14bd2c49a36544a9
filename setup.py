"""Builds the pages of `docs/` into the package, so that the service shows them under /docs/ wherever it is installed."""

import os
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

PAGES = Path(__file__).parent / "mkdocs.yml"


class BuildWithPages(build_py):
    """Builds the site first; the package's data then take it along."""

    def run(self) -> None:
        """Build all; without the pages where their builder is not installed (`pip install --no-build-isolation`)."""
        if PAGES.is_file():
            self._build_pages()
        super().run()

    def _build_pages(self) -> None:
        os.environ["NO_MKDOCS_2_WARNING"] = "1"
        try:
            from mkdocs.commands.build import build  # noqa: PLC0415
            from mkdocs.config import load_config  # noqa: PLC0415
        except ModuleNotFoundError:
            self.announce(
                "mkdocs-material is not installed: the package is built without the pages of docs/",
                level=3,
            )
            return
        config = load_config(str(PAGES))
        config.plugins.run_event("startup", command="build", dirty=False)
        build(config)


setup(cmdclass={"build_py": BuildWithPages})
