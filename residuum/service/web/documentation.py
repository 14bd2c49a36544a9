"""The documentation under /docs/: the site that an installation builds beside this file
(`setup.py`), and `make docs` anew.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
from functools import lru_cache
from pathlib import Path

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

SITE = Path(__file__).parent / "site"
_INLINE_SCRIPT = re.compile(
    rb"<script(?![^>]*\bsrc=)(?![^>]*application/json)[^>]*>(.*?)</script>", re.DOTALL
)


def documentation_routes(site: Path = SITE) -> list[BaseRoute]:
    """The site under /docs/; where it was not built, one line that says how to."""
    if (site / "index.html").is_file():
        return [Mount("/docs", _Site(directory=site, html=True))]
    return [Route("/docs", _not_built), Route("/docs/{path:path}", _not_built)]


async def _not_built(_request: Request) -> Response:
    return PlainTextResponse(
        "The documentation is not built here: run `make docs`. Its text is in the folder docs/.\n",
        404,
    )


class _Site(StaticFiles):
    """The built pages. Their own few inline scripts are allowed by what they hold; nothing else is,
    and nothing from outside.
    """

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """The file, with the policy of its page."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Cache-Control"] = "no-cache"
        if str(full_path).endswith(".html"):
            response.headers["Content-Security-Policy"] = _policy(
                str(full_path), stat_result.st_mtime_ns
            )
        return response


@lru_cache(maxsize=256)
def _policy(page: str, _changed: int) -> str:
    """What the page may load: its site's files, and the inline scripts that it holds."""
    inline = {
        hashlib.sha256(script).digest()
        for script in _INLINE_SCRIPT.findall(Path(page).read_bytes())
    }
    hashes = " ".join(sorted(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in inline))
    return (
        f"default-src 'none'; script-src 'self' {hashes}; style-src 'self' 'unsafe-inline'; img-src"
        " 'self' data:; font-src 'self'; connect-src 'self'; worker-src 'self'; base-uri 'none';"
        " form-action 'none'; frame-ancestors 'none'"
    )
