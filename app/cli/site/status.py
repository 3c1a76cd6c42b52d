"""``lineside status``: a site on one screen: dashboard, buses, stores, disk, certificates, backups."""

from __future__ import annotations

import json
import ssl
from pathlib import Path
from typing import Any

import click
import httpx

from app.cli.api.credentials import bearer_token
from app.cli.api.dashboard import dashboard
from app.cli.ending import report
from app.cli.options import config_option, json_option, token_file_option, token_option
from app.cli.serving.listening import url_of
from app.cli.site.status_lines import facts_json, facts_lines, site_facts
from app.core.server.settings import TlsSettings
from app.settings import load
from app.version import VERSION
from bus.errors import LinesideError
from bus.instants import unix_now
from bus.messages import Message, number
from bus.settings import BusSettings

WITHIN_S = 5.0
NO_CHECK_TIME = 0x200000
"""X509_V_FLAG_NO_CHECK_TIME (openssl/x509_vfy.h), which the module ssl has no name for."""


@click.command
@config_option
@token_option
@token_file_option
@json_option
def status(config: Path, token: str, token_file: Path | None, as_json: bool) -> None:
    """Show whether the dashboard serves, the version, the stores with their sizes, for how long the disk is
    enough, the ends of certificates, and the newest and the next backup; with a token of any role but worker
    also the state of each bus and what is degraded of the server.

    Exit 0 when it serves, else 1.
    """
    settings, bearer = load(config), bearer_token(token, token_file, required=False)
    tls = settings.server.tls
    own, fault = verification(tls)
    url = url_of(settings.server.host, settings.server.port, "http" if tls is None else "https")
    serves = is_serving(url, own)
    # A token is sent to the configured certificate only.
    buses, degraded = _state(url, bearer, own) if serves and bearer and fault is None else (None, None)
    if fault is not None:
        degraded = [{"code": fault.code, "since": None, "message": str(fault)}]
    facts = site_facts(settings, unix_now())
    if as_json:
        shown = {"serving": serves, "url": url, "store": str(settings.server.store), "buses": buses}
        click.echo(json.dumps({**shown, "degraded": degraded, **facts_json(settings, facts)}))
    else:
        code = "dashboard_serves" if serves else "dashboard_is_off"
        report(Message.of(code, site=settings.site.name, url=url, version=VERSION))
        lines = map(_configured, settings.bus) if buses is None else map(_line, buses)
        for line in (*lines, *facts_lines(settings, facts)):
            click.echo(f"  {line}")
        for each in degraded or ():
            report(Message.of("site_degraded", fault=each["message"]))
        if serves and not bearer:
            report(Message("status_needs_token"))
    if not serves:
        raise LinesideError(Message.of("not_serving", url=url, config=str(config)))


def verification(tls: TlsSettings | None) -> tuple[ssl.SSLContext | None, Message | None]:
    """Return what verifies this machine's own server; instead, where its file of certificates is damaged, the
    reason: a server that read it before still serves."""
    from bus.tls import TlsFileError

    try:
        return own_certificate(tls), None
    except TlsFileError as error:
        return None, error.message


def own_certificate(tls: TlsSettings | None) -> ssl.SSLContext | None:
    """Trusts the configured certificate itself, under any name and at any time: this machine calls itself.
    None without TLS. Raises TlsFileError."""
    if tls is None:
        return None
    from bus.tls import read_certificate

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN | NO_CHECK_TIME
    context.load_verify_locations(cadata=read_certificate(tls.certificate).der)
    return context


def is_serving(url: str, own: ssl.SSLContext | None = None) -> bool:
    """Whether a Lineside dashboard serves at ``url``; ``own``: what verifies it by https, if anything can."""
    try:
        # Without TLS there is nothing to verify: the authorities of the machine are not read.
        response = httpx.get(f"{url}/healthz", timeout=WITHIN_S, trust_env=False, verify=own or False)
        return response.status_code == 200 and response.json() == {"status": "ok"}
    except (httpx.HTTPError, httpx.InvalidURL, ValueError):
        return False


def _state(
    url: str, token: str, own: ssl.SSLContext | None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The buses, and the faults of the server."""
    with dashboard(url, token, own) as client:
        line, alarms = client.get("/line"), client.get("/alarms")["alarms"]
    history = line["history"]
    stored = {"code": history["code"], "since": None, "message": history["detail"]} if history else None
    faults = [
        {name: alarm[name] for name in ("code", "since", "message")}
        for alarm in alarms
        if alarm["bus"] is None and alarm["active"]
    ]
    return [_bus(bus) for bus in line["buses"]], [*faults, *([stored] if stored else [])]


def _bus(bus: dict[str, Any]) -> dict[str, Any]:
    shown = ("name", "worker", "link", "link_cause", "scan_hz")
    return {
        **{name: bus.get(name) for name in shown},
        "units": len(bus["units"]),
        "units_online": sum(unit["link"] == "online" for unit in bus["units"]),
    }


def _configured(bus: BusSettings) -> Message:
    return Message.of("check_bus", bus=bus.name, n=len(bus.unit), port=bus.port, baud=bus.baud)


def _line(bus: dict[str, Any]) -> Message:
    units = {"bus": bus["name"], "online": bus["units_online"], "units": bus["units"], "link": bus["link"]}
    if bus["link_cause"]:
        return Message("bus_not_open", {**units, "cause": bus["link_cause"]["detail"]})
    if bus["scan_hz"]:
        return Message("bus_scanned", {**units, "hz": number(f"{bus['scan_hz']:.1f}")})
    return Message("bus_open", units)
