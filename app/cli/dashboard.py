"""A running dashboard for commands: its HTTP API, and its errors in words."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from typing import Any

import httpx

from app.engineering.sets.model import ParameterRow, UnitRows
from app.errors import system_error
from bus.errors import CallerError, LinesideError
from bus.instants import UnixTime
from bus.messages import Message

_AUTHORITIES = ("SSL_CERT_FILE", "SSL_CERT_DIR")
_TIMEOUT_S = 600.0
"""The longest wait for a response: a full list of 40 parameters waits for gaps of a busy line."""


class DashboardError(LinesideError):
    """Raised if the dashboard could not be reached, or did not carry out the request."""


class Dashboard:
    """The HTTP API of a dashboard, opened by `dashboard`."""

    def __init__(self, client: httpx.Client) -> None:
        self._client = client

    def get(self, path: str, **query: str) -> Any:
        """Return the JSON of ``/api/v1`` + ``path``. Raise DashboardError or CallerError."""
        return self._call("GET", path, params=query)

    def post(self, path: str, body: Mapping[str, Any] | None = None) -> Any:
        """Post a JSON body; return the JSON of the response."""
        return self._call("POST", path, json=dict(body or {}))

    def units(self, bus: str) -> dict[int, str]:
        """Return the names of the units of a bus by address, in floor order."""
        buses = {found["name"]: found for found in self.get("/line")["buses"]}
        if bus not in buses:
            raise CallerError(
                Message.of("dashboard_lacks_bus", bus=bus, known=", ".join(sorted(buses)) or "none")
            )
        return {unit["id"]: unit["name"] for unit in buses[bus]["units"]}

    def check_unit(self, bus: str, unit: int) -> str:
        """Return the name of a unit. Raise CallerError if it is not configured."""
        units = self.units(bus)
        if unit not in units:
            known = ", ".join(str(number) for number in units)
            raise CallerError(Message.of("dashboard_lacks_unit", bus=bus, unit=unit, known=known or "none"))
        return units[unit]

    def read_unit(self, bus: str, unit: int, *, gaps: bool = False) -> UnitRows:
        """Read all parameters of a unit now; ``gaps``: only in the gaps of the scan."""
        name = self.check_unit(bus, unit)
        query = {"refresh": "true", "gaps": str(gaps).lower()}
        rows = [_row(given) for given in self.get(f"/buses/{bus}/units/{unit}/parameters", **query)]
        return UnitRows(unit, name, {row.number: row for row in rows})

    def _call(self, method: str, path: str, **request: Any) -> Any:
        try:
            response = self._client.request(method, f"/api/v1{path}", **request)
        except (httpx.HTTPError, UnicodeError) as error:
            url = str(self._client.base_url)
            advice = Message("name_authority" if _is_untrusted(error) else "is_dashboard_running")
            raise DashboardError(
                Message.of("dashboard_unreachable", url=url, error=str(error), advice=advice)
            ) from error
        if response.is_success:
            return response.json()
        raise DashboardError(_problem_message(response))


@contextmanager
def dashboard(url: str, token: str, own: ssl.SSLContext | None = None) -> Iterator[Dashboard]:
    """Open a dashboard by its base URL and a bearer token. ``own``: verifies the dashboard of this machine.
    Raise CallerError for a malformed URL."""
    if not url.startswith(("http://", "https://")):
        raise CallerError(Message.of("dashboard_url_malformed", url=url))
    client = httpx.Client(
        base_url=url.rstrip("/"),
        headers={"Authorization": f"Bearer {token}"},
        timeout=_TIMEOUT_S,
        trust_env=False,  # a proxy from the environment leads out of the plant
        verify=own or (trusted_authorities() if url.startswith("https://") else True),
    )
    with client:
        yield Dashboard(client)


def trusted_authorities() -> ssl.SSLContext:
    """Return a context that trusts only the certificates of ``SSL_CERT_FILE`` or ``SSL_CERT_DIR`` if one is
    set, as OpenSSL does; else the well-known ones and those of this machine. Raise CallerError for a file
    without certificates."""
    named = next((name for name in _AUTHORITIES if os.environ.get(name)), "")
    try:
        context = httpx.create_ssl_context()
    except OSError as error:
        why = Message("no_certificate") if isinstance(error, ssl.SSLError) else system_error(error)
        raise CallerError(
            Message.of("authorities_unusable", variable=named, value=os.environ.get(named, ""), reason=why)
        ) from error
    if not named:
        context.load_default_certs()
    return context


def _is_untrusted(error: BaseException | None) -> bool:
    """Return whether an error came from a certificate that no trusted authority has signed."""
    while error is not None and not isinstance(error, ssl.SSLCertVerificationError):
        error = error.__cause__ or error.__context__
    return error is not None


def _row(given: Mapping[str, Any]) -> ParameterRow:
    read_at = given.get("read_at")
    at = UnixTime(datetime.fromisoformat(read_at).timestamp()) if isinstance(read_at, str) else read_at
    return ParameterRow(given["number"], given["raw"], bool(given["available"]), at)


def _problem_message(response: httpx.Response) -> Message:
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    if problem.get("detail"):
        return Message.of("dashboard_refused", detail=str(problem["detail"]))
    method, path = response.request.method, response.request.url.path
    return Message.of("dashboard_failed", method=method, path=path, status=response.status_code)
