"""Settings of the service: from the command line, the environment (`RESIDUUM_…`) and one YAML
file.
"""

from __future__ import annotations

import ipaddress
import os
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import AnyHttpUrl, Field, ValidationError, field_validator, model_validator
from pydantic_settings import (
    BaseSettings,
    InitSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

from residuum.identification.errors import BadInput
from residuum.identification.yaml_text import read_yaml
from residuum.nearest_names import did_you_mean, known_names
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.broker import BrokerAddress, BrokerTls, broker_address
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.receivers import RECEIVERS, AnyReceiver
from residuum.service.secret_texts import first_line

SETTINGS_FILE = "RESIDUUM_SETTINGS"
"""Environment variable that names the YAML file."""

# The YAML file that `load_settings` was given, while it builds the settings. In a variable of the
# context, not in the environment: there the next settings of the process read it, too.
_FILE_GIVEN: ContextVar[Path | None] = ContextVar("_FILE_GIVEN", default=None)


# Requests a second a client may make of a service that other machines can reach.
_RATE_LIMIT = 200.0


class BadSettings(BadInput):
    """A setting is unknown, malformed or unsafe; the message names it and the rule."""


class Settings(BaseSettings):
    """Everything that can be set, with its default.

    Precedence: arguments, then environment variables (`RESIDUUM_PORT=9000`, nested by `__`), then
    the YAML file that `RESIDUUM_SETTINGS` names. Unknown keys are refused. Use `load_settings` for
    one-line messages.
    """

    model_config = SettingsConfigDict(
        env_prefix="RESIDUUM_", env_nested_delimiter="__", extra="forbid", frozen=True
    )

    host: str = Field(
        "127.0.0.1",
        description="Address to listen on. Any but a loopback address needs `api_keys`.",
    )
    port: int = Field(8000, ge=0, le=65535, description="TCP port; 0 takes a free one.")
    data: Path = Field(
        Path("var"), description="Folder of signal blocks, baselines and the default database."
    )
    database: str = Field(
        "",
        description=(
            "SQLAlchemy URL (sqlite:///…, postgresql+psycopg://…); empty: SQLite in `data`."
        ),
    )
    demo: bool = Field(False, description="Start the simulated machines and watch them.")
    demo_speed: float = Field(
        1.0,
        ge=0.01,
        le=100,
        description="How many times faster than real time the demo's machines live.",
    )
    demo_opcua: str = Field(
        "",
        description=(
            "Address at which the demo's process plant offers itself over OPC UA, too:"
            " opc.tcp://127.0.0.1:4841/."
        ),
    )
    machines: list[MachineSettings] = Field(
        [], description="Machines to watch: sources, windows, diagnoser."
    )
    growing_files: Path | None = Field(
        None,
        description=(
            "Folder below which machines that are added over HTTP may read growing files; empty:"
            " none."
        ),
    )
    api_keys: Path | None = Field(
        None, description="File of API keys, a line each: name role SHA-256-of-the-key."
    )
    oidc_issuer: AnyHttpUrl | None = Field(
        None,
        description=(
            "OpenID Connect issuer whose bearer tokens are taken beside API keys; its https"
            " address."
        ),
    )
    oidc_audience: str = Field(
        "residuum", min_length=1, description="Audience that a bearer token must be for."
    )
    oidc_role_claim: str = Field(
        "residuum_role",
        description="Claim of a token with its roles: viewer, operator, engineer, admin.",
    )
    oidc_site_claim: str = Field(
        "residuum_sites", description="Claim with the sites of its caller; without it: all."
    )
    tls_certificate: Path | None = Field(
        None, description="PEM file of the certificate (chain); with `tls_key`: HTTPS."
    )
    tls_key: Path | None = Field(None, description="PEM file of the certificate's private key.")
    public_url: AnyHttpUrl | None = Field(
        None,
        description=(
            "Address by which people reach the service through a proxy, https://plant.example/;"
            " needs keys."
        ),
    )
    trusted_proxies: list[str] = Field(
        [],
        max_length=100,
        description=(
            "Addresses or networks of proxies whose X-Forwarded-For and -Proto are believed."
        ),
    )
    webhooks: list[AnyHttpUrl] = Field(
        [], description="Addresses to which every change of an alarm is posted as JSON."
    )
    receivers: list[AnyReceiver] = Field(
        [],
        max_length=50,
        description=(
            "More who are told every change of an alarm, each of a kind: "
            + ", ".join(RECEIVERS)
            + "."
        ),
    )
    service_url: AnyHttpUrl | None = Field(
        None,
        description=(
            "Address of the service to which `residuum gateway` sends windows,"
            " https://plant.example:8000/."
        ),
    )
    service_key_file: Path | None = Field(
        None, description="File whose first line is an engineer's API key for `service_url`."
    )
    service_ca: Path | None = Field(
        None,
        description=(
            "PEM file of the authority that signed the certificate of `service_url`; empty: the"
            " system's."
        ),
    )
    mqtt: str = Field(
        "",
        description=(
            "Broker for alarms and findings, mqtt://[user:password@]host[:port][/prefix], mqtts://"
            " for TLS; empty: none."
        ),
    )
    mqtt_password_file: Path | None = Field(
        None, description="File whose first line is the password of the user of `mqtt`."
    )
    mqtt_ca: Path | None = Field(
        None,
        description=(
            "PEM file of the authority that signed the certificate of an mqtts:// broker; empty:"
            " the system's."
        ),
    )
    mqtt_certificate: Path | None = Field(
        None, description="PEM file of our certificate for an mqtts:// broker; with `mqtt_key`."
    )
    mqtt_key: Path | None = Field(None, description="PEM file of that certificate's private key.")
    opcua_server: str = Field(
        "",
        description=(
            "Address at which findings and alarms are offered as OPC UA nodes,"
            " opc.tcp://127.0.0.1:4840/; empty: none."
        ),
    )
    opcua_anonymous: bool = Field(
        False,
        description=(
            "Whether anybody may read at `opcua_server`, unsecured; else holders of an API key,"
            " signed and encrypted."
        ),
    )
    sparkplug: str = Field(
        "",
        description=(
            "Edge node, GROUP/NODE, as which findings are published as Sparkplug B on the broker of"
            " `mqtt`; empty: none."
        ),
    )
    workers: int = Field(
        # one core is left for what answers requests
        default_factory=lambda: max(1, min(4, (os.cpu_count() or 2) - 1)),
        ge=1,
        description="Processes that run diagnosers.",
    )
    keep_days: float = Field(
        30.0,
        gt=0,
        description="Days for which signals of windows are kept; findings stay (inf: for ever).",
    )
    keep_bytes: int = Field(
        2**30,
        ge=0,
        description=(
            "Bytes of windows' signals that are kept at most; the oldest go first, findings stay."
        ),
    )
    keep_rows: int = Field(
        200_000,
        ge=100,
        description=(
            "Windows whose rows and findings are kept at most; older ones are folded into hours."
        ),
    )
    keep_row_days: float = Field(
        365.0, gt=0, description="Days for which rows and findings are kept; then they are hours."
    )
    alarms: AlarmRule = Field(
        AlarmRule(),
        description=(
            "Rule of alarms: deadband, delays, latch, priority, shelving, suppression by a state of"
            " the machine."
        ),
    )
    body_limit: int = Field(64 * 2**20, ge=1024, description="Largest request body [bytes].")
    rate_limit: float | None = Field(
        None,
        gt=0,
        description=(
            "Requests a second that a client may make; default: 200, and no limit on a loopback"
            " address."
        ),
    )
    connections_per_address: int = Field(
        100,
        ge=1,
        description=(
            "Connections of one address that have shown no key; another takes the place of the"
            " oldest of them."
        ),
    )
    upload_memory: int = Field(
        512 * 2**20,
        ge=2**28,
        description="Memory in which an uploaded file must be readable [bytes].",
    )
    upload_seconds: int = Field(
        10, ge=1, description="Processor time in which an uploaded file must be readable [s]."
    )
    allow_fmus: bool = Field(
        False,
        description=(
            "Whether FMUs, and baselines that hold one, are stored, trained with and judged by: the"
            " native code runs in a process of its own, as the service's user."
        ),
    )
    header_limit: int = Field(16 * 2**10, ge=1024, description="Largest request head [bytes].")
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="Least severe log line that is kept."
    )
    log_format: Literal["console", "json"] = Field(
        "console", description="Log lines for people or for machines."
    )

    @property
    def database_url(self) -> str:
        """The database's URL, with the default filled in."""
        return self.database or f"sqlite:///{(self.data / 'residuum.db').resolve()}"

    @property
    def broker(self) -> BrokerAddress:
        """The broker, and how it is entered. Raises BadSettings when the file of the password
        cannot be read.
        """
        password = None
        if self.mqtt_password_file is not None:
            try:
                password = first_line(self.mqtt_password_file, "mqtt_password_file")
            except BadInput as error:
                raise BadSettings(str(error)) from None
        tls = BrokerTls(ca=self.mqtt_ca, certificate=self.mqtt_certificate, key=self.mqtt_key)
        return broker_address(self.mqtt, tls, password)

    def alarm_rule(self, asset: str) -> AlarmRule:
        """The rule of a machine's alarms: its own, or that of the service."""
        own = (
            machine.alarm_rule(self.alarms) for machine in self.machines if machine.asset == asset
        )
        return next(own, self.alarms)

    @property
    def requests_per_second(self) -> float | None:
        """The rate limit of a client, with the default filled in; None: no limit."""
        return _RATE_LIMIT if self.rate_limit is None and self.open_to_others else self.rate_limit

    @property
    def open_to_others(self) -> bool:
        """Whether other machines reach the service, themselves or through a proxy."""
        return not is_loopback(self.host) or self.public_url is not None

    # Each rule of several settings stands alone, so that the first that is broken is the one told.
    @model_validator(mode="after")
    def _refuse_an_open_door(self) -> Settings:
        if not is_loopback(self.host) and self.api_keys is None and self.oidc_issuer is None:
            raise ValueError(
                f"host {self.host!r} can be reached from other machines; set api_keys first, or"
                " listen on 127.0.0.1"
            )
        return self

    @model_validator(mode="after")
    def _refuse_a_proxy_s_open_door(self) -> Settings:
        if self.public_url is None:
            return self
        if self.api_keys is None and self.oidc_issuer is None:
            raise ValueError(
                f"public_url {str(self.public_url)!r}: others reach the service by it; set api_keys"
                " first"
            )
        if (
            self.public_url.path not in (None, "", "/")
            or self.public_url.query
            or self.public_url.username
        ):
            raise ValueError(
                f"public_url {str(self.public_url)!r}: must be a scheme and a name, as"
                " https://plant.example/"
            )
        return self

    @field_validator("trusted_proxies")
    @classmethod
    def _networks(cls, value: list[str]) -> list[str]:
        for network in value:
            try:
                ipaddress.ip_network(network, strict=False)
            except ValueError:
                raise ValueError(
                    f"{network!r} is neither an address nor a network; write 10.0.0.7 or"
                    " 10.0.0.0/24"
                ) from None
        return value

    @model_validator(mode="after")
    def _issuer_by_tls(self) -> Settings:
        issuer = self.oidc_issuer
        if issuer is not None and issuer.scheme != "https" and not is_loopback(str(issuer.host)):
            raise ValueError(
                f"oidc_issuer {str(issuer)!r}: its keys decide who may in, so it must be an https"
                " address"
            )
        return self

    @model_validator(mode="after")
    def _certificate_and_key(self) -> Settings:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key: one of them is not enough")
        return self

    @model_validator(mode="after")
    def _node_and_broker(self) -> Settings:
        if self.sparkplug and not self.mqtt:
            raise ValueError("sparkplug: needs a broker; set mqtt, too")
        return self

    @field_validator("sparkplug")
    @classmethod
    def _edge_node(cls, value: str) -> str:
        if value and (value.count("/") != 1 or not all(value.split("/")) or set(value) & set("+#")):
            raise ValueError("must be GROUP/NODE, without + and #")
        return value

    @model_validator(mode="after")
    def _opcua_users(self) -> Settings:
        if self.opcua_server and self.api_keys is None and not self.opcua_anonymous:
            raise ValueError(
                "opcua_server: clients show an API key, so set api_keys; or opcua_anonymous: true,"
                " where anybody may read"
            )
        return self

    @field_validator("opcua_server", "demo_opcua")
    @classmethod
    def _opcua_address(cls, value: str) -> str:
        if value and not value.startswith("opc.tcp://"):
            raise ValueError("must be opc.tcp://host:port/")
        return value

    @field_validator("mqtt")
    @classmethod
    def _broker(cls, value: str) -> str:
        if value:
            broker_address(value)
        return value

    @model_validator(mode="after")
    def _entered_as_it_says(self) -> Settings:
        if (self.mqtt_certificate is None) != (self.mqtt_key is None):
            raise ValueError("mqtt_certificate and mqtt_key: one of them is not enough")
        if (self.mqtt_ca or self.mqtt_certificate) and not self.mqtt.startswith("mqtts://"):
            raise ValueError(
                "mqtt_ca, mqtt_certificate: are for a broker that is entered by TLS; write mqtt:"
                " mqtts://…"
            )
        if self.mqtt_password_file and broker_address(self.mqtt or "mqtt://nobody").user is None:
            raise ValueError(
                "mqtt_password_file: is the password of a user; write mqtt: mqtts://USER@…"
            )
        return self

    @model_validator(mode="after")
    def _service_by_what_it_says(self) -> Settings:
        url = self.service_url
        if url is None and (self.service_key_file or self.service_ca):
            raise ValueError("service_key_file, service_ca: are for service_url; set it, too")
        if url is not None and (url.username or url.query or url.fragment):
            raise ValueError(
                "service_url: must be https://host[:port]/, without a user; a key stands in"
                " service_key_file"
            )
        return self

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Arguments before environment before file (pydantic-settings asks for this)."""
        # pydantic-settings makes its sources before it knows the arguments: the file comes this way
        named = _FILE_GIVEN.get() or os.environ.get(SETTINGS_FILE)
        file = InitSettingsSource(settings_cls, _content(Path(named)) if named else {})
        return init_settings, env_settings, file


@lru_cache(maxsize=64)
def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address.

    >>> is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def load_settings(file: Path | None = None, **arguments: Any) -> Settings:
    """Settings from all sources; arguments that are None count as not given. `file` stands before
    `RESIDUUM_SETTINGS`.

    Raises BadSettings with one line: which setting, what it is, which rule.
    """
    named = file or os.environ.get(SETTINGS_FILE)
    if named and not Path(named).is_file():
        raise BadSettings(f"{'--settings' if file else SETTINGS_FILE}: no such file: {named}")
    # options that were not given are None, and must not stand before the environment
    given = _FILE_GIVEN.set(file)
    try:
        return Settings(**{name: value for name, value in arguments.items() if value is not None})
    except ValidationError as error:
        raise BadSettings(_one_line(error)) from None
    finally:
        _FILE_GIVEN.reset(given)


def _content(file: Path) -> dict[str, Any]:
    """What a settings file says; BadSettings with the line where it is no YAML."""
    content = read_yaml(file, BadSettings) or {}
    if not isinstance(content, dict):
        raise BadSettings(f"{file}: is no settings file; write one setting a line, as `port: 8000`")
    return content


def _one_line(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    where = ".".join(map(str, first["loc"]))
    says = first["msg"].removeprefix("Value error, ")
    if first["loc"][:1] in _SECRET:
        return f"setting {where}: {_of_receiver(first, says)}"
    if first["type"] == "extra_forbidden":
        asked = did_you_mean(where, Settings.model_fields)
        return f"setting {where}: is not known; {asked}docs/reference/settings.md lists all"
    return f"settings: {says}" if not where else f"setting {where}: {first['input']!r}: {says}"


# What is refused here may be a secret, or hold one: it is not repeated.
_SECRET = (("receivers",), ("webhooks",))


def _of_receiver(error: Any, says: str) -> str:
    """A refusal of a part of a receiver."""
    place = error["loc"]
    if error["type"] == "union_tag_invalid":
        return f"kind: {known_names(error['ctx']['tag'], RECEIVERS)}"
    if error["type"] == "union_tag_not_found":
        return f"kind: is missing; {known_names('', RECEIVERS)}"
    if error["type"] == "extra_forbidden" and len(place) > 3:
        fields = RECEIVERS[place[2]].model_fields.items()
        return f"is not known; {known_names(place[3], [f.alias or name for name, f in fields])}"
    return says
