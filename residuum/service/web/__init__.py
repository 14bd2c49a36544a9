"""The page: plain HTML, ES modules and CSS beside this file, and Plotly from the installed
package. The documentation under /docs/: the site that an installation builds beside this file
(`setup.py`), and `make docs` anew.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import os
import re
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

_HERE = Path(__file__).parent
_HOUR = "public, max-age=3600"
SITE = _HERE / "site"
_INLINE_SCRIPT = re.compile(
    rb"<script(?![^>]*\bsrc=)(?![^>]*application/json)[^>]*>(.*?)</script>", re.DOTALL
)


def web_routes() -> list[BaseRoute]:
    """The page at /, its assets under /web, Plotly under /vendor, the documentation under /docs."""
    return [
        Route("/", _page),
        Route("/vendor/plotly.min.js", _plotly),
        Mount("/web", _Assets(directory=_HERE / "assets")),
        *documentation_routes(),
    ]


class _Assets(StaticFiles):
    """Files that the browser asks about every time (they are small), so a new version shows at
    once; packed on the way.
    """

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """The file, to be revalidated."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers["Cache-Control"] = "no-cache"
        if not isinstance(response, FileResponse) or "gzip" not in Headers(scope=scope).get(
            "accept-encoding", ""
        ):
            return response
        tags = {name: response.headers[name] for name in ("etag", "last-modified", "cache-control")}
        headers = {**tags, "Content-Encoding": "gzip", "Vary": "Accept-Encoding"}
        return Response(
            _packed(str(full_path), stat_result.st_mtime_ns),
            status_code,
            headers,
            response.media_type,
        )


@lru_cache(maxsize=128)
def _packed(file: str, _changed: int) -> bytes:
    return gzip.compress(Path(file).read_bytes(), 6)


async def _page(_request: Request) -> Response:
    return FileResponse(_HERE / "index.html", headers={"Cache-Control": "no-cache"})


def _plotly(request: Request) -> Response:
    plain, packed = _plotly_files()
    if "gzip" not in request.headers.get("accept-encoding", ""):
        return Response(plain, media_type="text/javascript", headers={"Cache-Control": _HOUR})
    headers = {"Cache-Control": _HOUR, "Content-Encoding": "gzip", "Vary": "Accept-Encoding"}
    return Response(packed, media_type="text/javascript", headers=headers)


@lru_cache(maxsize=1)
def _plotly_files() -> tuple[bytes, bytes]:
    """Plotly as it is installed, and packed."""
    plain = files("plotly").joinpath("package_data/plotly.min.js").read_bytes()
    return plain, gzip.compress(plain, 5)


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
    # By the hash of what they hold: `unsafe-inline` would allow whatever else came into a page.
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
