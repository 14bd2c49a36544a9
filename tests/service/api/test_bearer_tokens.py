"""Bearer tokens of an issuer with its own keys, over HTTP: who is believed, as what, and who is not."""

import base64
import hashlib
import hmac
import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.security.access import new_key
from residuum.service.settings import BadSettings, load_settings

jwt = pytest.importorskip(
    "jwt", reason="the extra 'oidc' is not installed: bearer tokens were not tried"
)
rsa = pytest.importorskip("cryptography.hazmat.primitives.asymmetric.rsa")
serialization = pytest.importorskip("cryptography.hazmat.primitives.serialization")

ALLOWED = {  # role → may it read assets, acknowledge, make an asset
    "viewer": (200, 403, 403),
    "operator": (200, 404, 403),
    "engineer": (200, 404, 200),
    "admin": (200, 404, 200),
}


class Issuer:
    """An OpenID Connect issuer with discovery and keys, and the tokens it signs."""

    def __init__(self):
        self.keys = {}
        self.asked = 0
        self.new_key("first")
        issuer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                issuer.asked += self.path.endswith("keys")
                found = {
                    "/.well-known/openid-configuration": {"jwks_uri": f"{issuer.url}/keys"},
                    "/keys": issuer.published(),
                }
                body = json.dumps(found[self.path]).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                """Say nothing."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def new_key(self, number):
        self.keys[number] = rsa.generate_private_key(public_exponent=65537, key_size=2048)

    def published(self):
        public = {
            number: jwt.algorithms.RSAAlgorithm.to_jwk(key.public_key(), as_dict=True)
            for number, key in self.keys.items()
        }
        return {
            "keys": [
                {**each, "kid": number, "use": "sig", "alg": "RS256"}
                for number, each in public.items()
            ]
        }

    def token(self, key="first", algorithm="RS256", signed_by=None, **claims):
        told = {
            "iss": self.url,
            "aud": "residuum",
            "sub": "eva",
            "exp": time.time() + 600,
            "residuum_role": "viewer",
        }
        told = {name: value for name, value in (told | claims).items() if value is not None}
        return jwt.encode(told, signed_by or self.keys[key], algorithm, headers={"kid": key})

    def public_pem(self):
        form = serialization.PublicFormat.SubjectPublicKeyInfo
        return self.keys["first"].public_key().public_bytes(serialization.Encoding.PEM, form)

    def stop(self):
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture(scope="module")
def issuer():
    issuer = Issuer()
    yield issuer
    issuer.stop()


@pytest.fixture(scope="module")
def client(run_service, issuer):
    service = run_service(host="0.0.0.0", oidc_issuer=issuer.url, rate_limit=1e6)
    for asset in ("hall-1.press", "hall-2.press"):
        record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
        service.services.store.add_window(asset, record, Finding("bearing", "healthy", reason="-"))
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        yield client


def _base64(plain):
    return base64.urlsafe_b64encode(json.dumps(plain).encode()).rstrip(b"=").decode()


def shown(token):
    return {"Authorization": f"Bearer {token}"}


@pytest.mark.parametrize("role", ALLOWED)
def test_a_token_may_what_its_role_may(client, issuer, role):
    for claim in (role, [role, "offline_access"], f"{role} monitor"):
        bearer = shown(issuer.token(residuum_role=claim))
        found = (
            client.get("/assets", headers=bearer).status_code,
            client.post("/alarms/999/acknowledge", headers=bearer).status_code,
            client.put("/assets/hall-1.new", json={}, headers=bearer).status_code,
        )
        assert found == ALLOWED[role], claim


def test_sites_of_a_token_cut_down_what_it_sees(client, issuer):
    bearer = shown(issuer.token(residuum_sites=["hall-2"]))
    assert {each["id"] for each in client.get("/assets", headers=bearer).json()["items"]} == {
        "hall-2.press"
    }
    assert client.get("/assets/hall-1.press", headers=bearer).status_code == 403
    assert (
        client.get("/assets", headers=shown(issuer.token(residuum_sites=["hall/2"]))).status_code
        == 401
    )


def test_what_is_not_the_issuers_word_is_not_believed(client, issuer):
    foreign = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    unsigned = jwt.encode(
        {"iss": issuer.url, "aud": "residuum", "exp": time.time() + 600},
        None,
        "none",
        headers={"kid": "first"},
    )
    head, body, _ = issuer.token().split(".")
    other_body = issuer.token(residuum_role="admin").split(".")[1]
    signing = ".".join([_base64({"alg": "HS256", "typ": "JWT", "kid": "first"}), body])
    public_key_as_secret = hmac.new(issuer.public_pem(), signing.encode(), hashlib.sha256).digest()
    wrong = {
        "by the public key as a secret": f"{signing}.{base64.urlsafe_b64encode(public_key_as_secret).rstrip(b'=').decode()}",
        "expired": issuer.token(exp=time.time() - 3600),
        "of no end": issuer.token(exp=None),
        "not valid yet": issuer.token(nbf=time.time() + 3600),
        "for another service": issuer.token(aud="others"),
        "for nobody": issuer.token(aud=None),
        "of another issuer": issuer.token(iss="https://evil.example"),
        "signed by another": issuer.token(signed_by=foreign),
        "of an unknown key": jwt.encode(
            {"iss": issuer.url}, foreign, "RS256", headers={"kid": "none"}
        ),
        "unsigned": unsigned,
        "changed": f"{head}.{other_body}.{issuer.token().split('.')[2]}",
        "without signature": f"{head}.{body}.",
        "by a shared secret": jwt.encode(
            {"iss": issuer.url, "aud": "residuum"}, "secret" * 8, "HS256", headers={"kid": "first"}
        ),
        "without a role": issuer.token(residuum_role=None),
        "of a role that is none": issuer.token(residuum_role=["root", 7]),
        "no token": "a.b.c",
        "of no text": "\xff.\xff.\xff",
    }
    for what, token in wrong.items():
        answer = client.get(
            "/assets", headers={"Authorization": f"Bearer {token}".encode("latin-1")}
        )
        assert answer.status_code == 401, what
        assert (
            answer.headers["content-type"] == "application/problem+json"
            and answer.headers["www-authenticate"] == "Bearer"
        )
    assert client.get("/assets").status_code == 401


def test_a_new_key_of_the_issuer_is_taken_up_and_guesses_do_not_ask_it_again_and_again(
    client, issuer, monkeypatch
):
    client.get("/assets", headers=shown(issuer.token()))
    # however long this takes here
    monkeypatch.setattr("residuum.service.security.bearer_tokens._KEYS_AGAIN", 3600.0)
    before = issuer.asked
    for number in range(20):
        client.get("/assets", headers=shown(issuer.token(key="first", sub=str(number))))
        forged = jwt.encode(
            {"iss": issuer.url}, issuer.keys["first"], "RS256", headers={"kid": f"guess-{number}"}
        )
        assert client.get("/assets", headers=shown(forged)).status_code == 401
    assert issuer.asked == before
    monkeypatch.setattr("residuum.service.security.bearer_tokens._KEYS_AGAIN", 0.0)
    issuer.new_key("second")
    assert client.get("/assets", headers=shown(issuer.token(key="second"))).status_code == 200


def test_keys_and_tokens_beside_each_other_and_an_issuer_that_is_away(run_service, tmp_path):
    key, digest = new_key()
    (tmp_path / "keys").write_text(f"eva viewer {digest}\n")
    service = run_service(
        host="0.0.0.0", api_keys=tmp_path / "keys", oidc_issuer="http://127.0.0.1:9", rate_limit=1e6
    )
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        assert client.get("/assets", headers={"X-API-Key": key}).status_code == 200
        assert client.get("/assets", headers=shown("a.b.c")).status_code == 401


def test_an_issuer_without_tls_is_refused_unless_it_is_this_machine():
    with pytest.raises(BadSettings, match="must be an https address"):
        load_settings(oidc_issuer="http://id.example")
    assert (
        load_settings(host="0.0.0.0", oidc_issuer="https://id.example/realms/plant").api_keys
        is None
    )
