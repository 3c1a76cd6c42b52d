"""The page of a bus of the file, or of a new one: its port, a scan of it, its units."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Form, Path
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.web.access import Person
from app.core.web.routes import GuardedRoute
from app.core.web.services import service
from app.core.web.templating import render
from app.errors import Problem
from app.system.configuration.api import FileOfServer
from app.system.configuration.document import Edit, TomlValue, at, with_values, without
from app.system.configuration.pages import SEE_OTHER, Digest, ReasonOfChange, buses_of, review_page
from app.system.configuration.port_scan import PortScan, ports
from app.system.configuration.service import CHANGE_PORTS, PresentFile
from bus.errors import CallerError
from bus.messages import Message
from bus.settings import BAUDS, BusSettings, check_port

router = APIRouter(prefix="/configuration/bus", include_in_schema=False, route_class=GuardedRoute)

MAX_UNITS_TEXT = 20_000
_DEFAULTS = {"baud": BusSettings.model_fields["baud"].default}
"""Of what the form always has: a file that leaves it out is left so."""
_UNIT = re.compile(r"(\d{1,3})[\s,;:.]+(\S.*)")
Changer = Annotated[Person, CHANGE_PORTS.permitted]
Scan = Annotated[PortScan, service(PortScan)]
Short = Annotated[str, Form(max_length=200)]
Index = Annotated[int, Path(ge=0, le=999)]


@router.get("/{index}")
async def bus_page(request: Request, _: Changer, file: FileOfServer, scan: Scan, index: Index) -> Response:
    """Show the form of a bus; the index behind the last one is that of a new one."""
    present = await file.present()
    return _form(request, present, scan, index, _texts_of(present, scan, index))


@router.post("/{index}/scan")
async def scan_port(
    _: Changer, file: FileOfServer, scan: Scan, index: Index, act: Short, port: Short = ""
) -> Response:
    """Begin a scan of a port, or end it. The page shows why one is refused."""
    present, port = await file.present(), port.strip()
    if act == "stop":
        await scan.stop()
    elif port in _ports_of(present):
        scan.refuse(port, Message.of("port_of_bus", port=port))
    else:
        try:
            check_port(port)
        except ValueError as error:
            scan.refuse(port, error.args[0])
        else:
            scan.start(port)
    return RedirectResponse(f"/configuration/bus/{index}", SEE_OTHER)


@router.get("/{index}/scan")
async def scan_state(_: Changer, scan: Scan, index: Index) -> Response:
    """Send the page to what was found, once the scan has ended."""
    if scan.is_running:
        return Response(status_code=204)
    return Response(headers={"HX-Redirect": f"/configuration/bus/{index}"})


@router.post("/{index}")
async def change_bus(
    request: Request,
    person: Changer,
    file: FileOfServer,
    scan: Scan,
    index: Index,
    name: Short = "",
    port: Short = "",
    baud: Short = "",
    units: Annotated[str, Form(max_length=MAX_UNITS_TEXT)] = "",
    digest: Digest = "",
    confirmed: Annotated[str, Form(max_length=10)] = "",
    reason_of_change: ReasonOfChange = "",
) -> Response:
    """Review the bus that was typed; with ``confirmed`` write it."""
    texts = {"name": name.strip(), "port": port.strip(), "baud": baud, "units": units}
    present = await file.present()
    _refuse_beyond(present, index)
    try:
        edit = bus_edit(index, _values(texts, scan), units_typed(units))
        review = await file.review(edit, digest)
    except CallerError as error:
        return _form(request, present, scan, index, texts, (error.message,))
    except Problem as problem:
        if problem.code != "superseded":
            raise
        return _form(request, present, scan, index, texts, (problem.message,), status=409)
    if review.faults or review.text == present.text:
        faults = review.faults or (Message("configuration_nothing_changed"),)
        return _form(request, present, scan, index, texts, tuple(map(_inner, faults)))
    if not confirmed:
        return review_page(request, file, present, review, f"/configuration/bus/{index}", texts)
    version = await file.save(person, CHANGE_PORTS, edit, digest, reason_of_change)
    return RedirectResponse(f"/configuration?done={version.number}", SEE_OTHER)


def bus_edit(index: int, values: Mapping[str, TomlValue], units: list[tuple[int, str]]) -> Edit:
    """Return the edit that gives a bus these values and units: one whose address is not listed any more is
    removed, a new one comes behind the last."""

    def edit(text: str) -> str:
        bus = at(tomllib.loads(text), ("bus", index)) or {}
        changes = {key: value for key, value in values.items() if bus.get(key, _DEFAULTS.get(key)) != value}
        text = with_values(text, ("bus", index), changes) if changes else text
        wanted, present = dict(units), [unit.get("id") for unit in bus.get("unit", [])]
        for place in reversed(range(len(present))):
            if present[place] not in wanted:
                text = without(text, ("bus", index, "unit", place))
                del present[place]
        for address, name in units:
            if address not in present:
                text = with_values(text, ("bus", index, "unit", len(present)), {"id": address, "name": name})
                present.append(address)
            elif at(tomllib.loads(text), (*(path := _unit(index, present, address)), "name")) != name:
                text = with_values(text, path, {"name": name})
        return text

    return edit


def units_typed(text: str) -> list[tuple[int, str]]:
    """Return address and name of each line that is not empty. Raises CallerError for one without both, and
    for an address that is given twice."""
    found: dict[int, str] = {}
    for line in filter(None, map(str.strip, text.splitlines())):
        match = _UNIT.fullmatch(line)
        if match is None or int(match[1]) in found:
            raise CallerError(Message.of("unit_line_malformed", line=line[:80]))
        found[int(match[1])] = match[2].strip()
    return list(found.items())


def _unit(index: int, present: list[int], address: int) -> tuple[str | int, ...]:
    return ("bus", index, "unit", present.index(address))


def _inner(fault: Message) -> Message:
    """Return a fault of the file without the number of its line."""
    inner = fault.params.get("fault")
    return inner if isinstance(inner, Message) else fault


def _values(texts: Mapping[str, str], scan: PortScan) -> dict[str, TomlValue]:
    """Return what was typed, with the settings that a scan of this port has shown."""
    found = scan.found if scan.found is not None and scan.port == texts["port"] else {}
    settings = {key: value for key, value in found.items() if key != "unit"}
    baud = int(texts["baud"]) if texts["baud"].isdecimal() else texts["baud"]
    return {**settings, "name": texts["name"], "port": texts["port"], "baud": baud}


def _ports_of(present: PresentFile) -> list[str]:
    return [str(bus.get("port")) for bus in buses_of(present)]


def _refuse_beyond(present: PresentFile, index: int) -> None:
    if index > len(buses_of(present)):
        raise Problem(404, "not_found", Message.of("configuration_no_table", name=f"bus.{index}"))


def _texts_of(present: PresentFile, scan: PortScan, index: int) -> dict[str, str]:
    """Return what the file has; of a new bus the next name, and what the scan has found."""
    buses = buses_of(present)
    names = {bus.get("name") for bus in buses}
    new = {"name": next(f"line-{n}" for n in range(1, len(names) + 2) if f"line-{n}" not in names)}
    bus = buses[index] if index < len(buses) else {**(scan.found or {}), **new, "port": scan.port}
    units = "\n".join(f"{unit.get('id')} {unit.get('name')}" for unit in bus.get("unit", []))
    return {
        "name": str(bus.get("name", "")),
        "port": str(bus.get("port", "")),
        "baud": str(bus.get("baud", _DEFAULTS["baud"])),
        "units": units,
    }


def _form(
    request: Request,
    present: PresentFile,
    scan: PortScan,
    index: int,
    texts: Mapping[str, str],
    faults: tuple[Message, ...] = (),
    status: int = 422,
) -> Response:
    _refuse_beyond(present, index)
    taken = _ports_of(present)
    return render(
        request,
        "configuration/bus.html",
        status=status if faults else 200,
        action=f"/configuration/bus/{index}",
        is_new=index == len(taken),
        digest=present.digest,
        faults=(*present.faults, *faults),
        texts=texts,
        scan=scan,
        ports=[port for port in ports() if port not in taken],
        bauds=[(str(each), str(each)) for each in sorted(BAUDS, reverse=True)],
    )
