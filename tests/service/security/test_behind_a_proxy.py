"""Behind a real proxy that ends TLS, set up as the documentation says: pages write, addresses are the client's own."""

import re
import shutil
import ssl
import subprocess
import time
from pathlib import Path

import httpx
import pytest

from residuum.service.security.access import new_key
from residuum.service.security.forwarded import TrustedProxies
from residuum.service.settings import BadSettings, load_settings
from tests.service.conftest import find_program, not_here, wait_for_port

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "deploy.md"
NAME = "plant.example"


def printed(kind, certificate):
    """The block of this language in the documentation, with a certificate of ours."""
    block = re.search(rf"```{kind}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    files = zip(("certificate.pem", "key.pem"), certificate, strict=True)
    for name, file in files:
        assert f"/etc/residuum/{name}" in block
        block = block.replace(f"/etc/residuum/{name}", str(file))
    return block


@pytest.fixture
def certificate(tmp_path):
    if shutil.which("openssl") is None:
        pytest.skip("NO OPENSSL HERE, so no proxy was tried")
    files = tmp_path / "certificate.pem", tmp_path / "key.pem"
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]
    command += [
        "-subj",
        f"/CN={NAME}",
        "-addext",
        f"subjectAltName=DNS:{NAME}",
        "-out",
        files[0],
        "-keyout",
        files[1],
    ]
    subprocess.run(command, check=True, capture_output=True)
    return files


@pytest.fixture
def service(run_service, tmp_path):
    """A service as it stands behind a proxy, and the key of an engineer."""
    key, digest = new_key()
    (tmp_path / "api_keys").write_text(f"eva engineer {digest}")
    port = {}

    def run(public_port):
        port["public"] = f"https://{NAME}:{public_port}"
        return run_service(
            api_keys=tmp_path / "api_keys",
            public_url=f"{port['public']}/",
            trusted_proxies=["127.0.0.1"],
        )

    return run, key


def nginx(folder, certificate, public, inner):
    block = printed("nginx", certificate).replace("127.0.0.1:8000", f"127.0.0.1:{inner}")
    block = block.replace("443 ssl", f"127.0.0.1:{public} ssl")
    temporary = "".join(
        f"{kind}_temp_path {folder}/{kind};\n"
        for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    (folder / "nginx.conf").write_text(
        f"daemon off;\nmaster_process off;\npid {folder}/pid;\nerror_log {folder}/error.log;\nevents {{}}\n"
        f"http {{\naccess_log off;\n{temporary}{block}}}\n"
    )
    return [
        find_program("nginx"),
        "-c",
        folder / "nginx.conf",
        "-p",
        folder,
        "-e",
        f"{folder}/error.log",
    ]


def caddy(folder, certificate, public, inner):
    block = (
        printed("caddy", certificate)
        .replace(NAME, f"{NAME}:{public}", 1)
        .replace("127.0.0.1:8000", f"127.0.0.1:{inner}")
    )
    (folder / "Caddyfile").write_text(
        f"{{\nadmin off\nauto_https disable_redirects\nstorage file_system {folder}\n}}\n{block}"
    )
    return [
        find_program("caddy"),
        "run",
        "--config",
        folder / "Caddyfile",
        "--adapter",
        "caddyfile",
    ]


@pytest.mark.parametrize("proxy", [nginx, caddy])
def test_the_page_writes_and_the_client_is_known_behind_a_proxy(
    proxy, certificate, service, free_port, tmp_path
):
    if find_program(proxy.__name__) is None:
        not_here(proxy.__name__.upper(), "the service behind it")
    run, key = service
    public = free_port()
    running = run(public)
    command = proxy(tmp_path, certificate, public, running.port)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            wait_for_port(public, process)
            trusted = ssl.create_default_context(cafile=certificate[0])
            url, headers = (
                f"https://127.0.0.1:{public}",
                {"Host": f"{NAME}:{public}", "X-API-Key": key},
            )
            more = {"sni_hostname": NAME}
            with httpx.Client(base_url=url, headers=headers, verify=trusted, timeout=60) as client:

                def ask(method, path, **request):
                    return client.request(method, path, extensions=more, **request)

                assert ask("GET", "/").status_code == 200
                own = {"Origin": f"https://{NAME}:{public}"}
                answer = ask("PUT", "/api/v1/assets/press", json={"title": "Press"}, headers=own)
                assert answer.status_code == 200, answer.text
                assert answer.headers["Strict-Transport-Security"]
                for other in ("https://evil.example", f"http://{NAME}:{public}", "null"):
                    assert (
                        ask(
                            "PUT", "/api/v1/assets/press", json={}, headers={"Origin": other}
                        ).status_code
                        == 403
                    )
                redirect = ask("GET", "/api/v1/assets/")
                assert redirect.headers.get("location", f"https://{NAME}").startswith(
                    f"https://{NAME}"
                )
                with client.stream("GET", "/api/v1/events", extensions=more) as events:
                    running.services.events.publish("job", {"id": "j"})
                    # as it comes
                    assert next(line for line in events.iter_lines() if '"id":"j"' in line)
        finally:
            process.kill()  # its way of ending waits for open streams


def test_only_a_trusted_proxy_is_believed():
    proxies = TrustedProxies(["10.0.0.0/8", "::1"])
    assert (
        proxies.client("10.0.0.1", "http", b"spoofed, 192.0.2.9", b"https").address == "192.0.2.9"
    )
    assert proxies.client("10.0.0.1", "http", b"192.0.2.9, 10.0.0.2", b"HTTPS").scheme == "https"
    assert proxies.client("10.0.0.1", "http", b"<script>", b"gopher") == proxies.client(
        "10.0.0.1", "http", b"", b""
    )
    assert proxies.client("192.0.2.1", "http", b"10.0.0.1", b"https").scheme == "http"
    assert (
        TrustedProxies([]).client("10.0.0.1", "http", b"192.0.2.9", b"https").address == "10.0.0.1"
    )


def test_limits_are_the_client_s_own_behind_a_trusted_proxy(service, run_service, tmp_path):
    run, key = service
    run(443)
    running = run_service(
        api_keys=tmp_path / "api_keys",
        public_url="https://plant.example",
        trusted_proxies=["127.0.0.0/8"],
        rate_limit=1.0,
    )
    begun = time.monotonic()

    def asked(client, times):
        head = {"X-Forwarded-For": client, "Host": NAME}
        return [
            httpx.get(f"{running.url}/api/v1/assets", headers=head).status_code
            for _ in range(times)
        ]

    first, second = asked("192.0.2.1", 6), asked("192.0.2.2", 1)
    # a busy machine may take as long as it likes
    assert 429 in first or time.monotonic() - begun > 4
    assert second == [401]
    assert key


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"public_url": "https://plant.example/"}, "set api_keys first"),
        ({"public_url": "https://plant.example/residuum"}, "public_url"),
        ({"trusted_proxies": ["plant.example"]}, "neither an address nor a network"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, says, tmp_path):
    with pytest.raises(BadSettings, match=says):
        load_settings(data=tmp_path, **settings)
