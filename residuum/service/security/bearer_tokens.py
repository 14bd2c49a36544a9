"""Bearer tokens of an OpenID Connect issuer: who may call is said by the plant's own directory.

A token is believed when its signature fits a public key that the issuer publishes, when it is for
this service, and while it is valid. Only asymmetric signatures are taken: with a shared secret,
whoever can verify a token could also write one.
"""

from __future__ import annotations

import hashlib
import threading
import time
import urllib.request
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import orjson
import structlog

from residuum.service.security.access import LONGEST_NAME, Caller, Role, site_names
from residuum.service.settings import BadSettings, Settings

log = structlog.get_logger()

_ALGORITHMS = [
    "RS256",
    "RS384",
    "RS512",
    "PS256",
    "PS384",
    "PS512",
    "ES256",
    "ES384",
    "ES512",
    "EdDSA",
]
# Seconds by which the issuer's clock may differ from ours.
_LEEWAY = 30.0
# Seconds for an answer of the issuer.
_PATIENCE = 5.0
# Of such an answer.
_MOST_BYTES = 2**20
# Seconds for which keys are kept, and after which they are asked for again because of a key that is
# not among them.
_KEYS_KEPT, _KEYS_AGAIN = 3600.0, 10.0
# Verified tokens that are remembered: a signature is verified once, not with each request.
_MOST_TOKENS = 1000
_NEEDED = ["exp", "iss", "aud"]


class BearerTokens:
    """Verifies tokens of the issuer of the settings.

    Roles are in the claim `oidc_role_claim` (a word or a list; unknown ones mean nothing, the
    highest counts), sites in `oidc_site_claim`; without that claim a caller is of no site, and may
    see all. A token without a role is nobody's.
    """

    def __init__(self, settings: Settings) -> None:
        try:
            self._jwt: Any = import_module("jwt")  # optional: the extra `oidc`
        except ImportError:
            raise BadSettings(
                "setting oidc_issuer: needs the extra `oidc`: pip install 'residuum[oidc]'"
            ) from None
        self._settings = settings
        self._issuer = str(settings.oidc_issuer).rstrip("/")
        self._keys: dict[str, Any] = {}
        self._fetched = float("-inf")
        self._known: dict[bytes, tuple[float, Caller]] = {}
        self._lock = threading.Lock()

    @staticmethod
    def looks_like_one(text: str | None) -> bool:
        """Whether a key may be a token: three parts with points between."""
        return text is not None and text.count(".") == 2

    def known(self, token: str) -> Caller | None:
        """Whose token this is, if it has been verified before and is still valid; asks nobody."""
        entry = self._known.get(hashlib.sha256(token.encode()).digest())
        return entry[1] if entry is not None and time.time() < entry[0] else None

    def caller(self, token: str) -> Caller | None:
        """Whose token this is; None when it cannot be believed. May ask the issuer for its keys, so
        not from an event loop.
        """
        try:
            key = self._key(str(self._jwt.get_unverified_header(token).get("kid", "")))
            if key is None:
                return None
            claims: Mapping[str, Any] = self._jwt.decode(
                token,
                key.key,
                # of the key alone: a token must not choose how it is verified
                algorithms=[name for name in _ALGORITHMS if name == key.algorithm_name],
                audience=self._settings.oidc_audience,
                # issuers write their own name with and without the slash
                issuer=[self._issuer, f"{self._issuer}/"],
                leeway=_LEEWAY,
                options={"require": _NEEDED},
            )
        except self._jwt.PyJWTError as error:
            log.info(
                "a bearer token was not believed", reason=f"{type(error).__name__}: {error}"[:200]
            )
            return None
        caller = self._named(claims)
        if caller is not None:
            with self._lock:
                while len(self._known) >= _MOST_TOKENS:
                    self._known.pop(next(iter(self._known)))
                self._known[hashlib.sha256(token.encode()).digest()] = float(claims["exp"]), caller
        return caller

    def _named(self, claims: Mapping[str, Any]) -> Caller | None:
        roles = [
            Role[word.upper()]
            for word in _words(claims.get(self._settings.oidc_role_claim))
            if word.upper() in Role.__members__
        ]
        sites = claims.get(self._settings.oidc_site_claim)
        try:
            of_sites = None if sites is None else site_names(_words(sites))
        except BadSettings as error:
            log.warning("a bearer token names a site that cannot be", reason=str(error))
            return None
        name = str(claims.get("preferred_username") or claims.get("sub") or "unnamed")[
            :LONGEST_NAME
        ].replace("\x00", "")
        return Caller(name, max(roles), of_sites) if roles else None

    def _key(self, number: str) -> Any:
        # under the lock: of many callers with a new key's tokens one asks the issuer
        with self._lock:
            age = time.monotonic() - self._fetched
            if age > _KEYS_KEPT or (number not in self._keys and age > _KEYS_AGAIN):
                self._fetch()
            return self._keys.get(number)

    def _fetch(self) -> None:
        # PyJWKClient fetches and reads. Its own cache is not used: it asks an issuer that is away
        # once a token, and forgets what it knew as the hour ends.
        self._fetched = time.monotonic()
        try:
            place = _get(f"{self._issuer}/.well-known/openid-configuration")["jwks_uri"]
            published = self._jwt.PyJWKClient(str(place), timeout=_PATIENCE).get_jwk_set().keys
            self._keys = {
                key.key_id or "": key for key in published if key.public_key_use in (None, "sig")
            }
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            AttributeError,
            self._jwt.PyJWTError,
        ) as error:
            log.error(
                "the issuer's keys cannot be had; those known are used",
                reason=f"{type(error).__name__}: {error}"[:200],
            )


def _words(claim: Any) -> list[str]:
    if isinstance(claim, str):
        return claim.split()
    return [word for word in claim if isinstance(word, str)] if isinstance(claim, list) else []


def _get(url: str) -> Any:
    if not url.startswith(("https://", "http://")):
        raise ValueError(f"{url[:100]!r} is no web address")
    with urllib.request.urlopen(url, timeout=_PATIENCE) as answer:
        return orjson.loads(answer.read(_MOST_BYTES))
