"""Frames as text for people and as fields for programs (``lineside decode``, the trace).

Field names are those of the HTTP API (contract): ``raw`` is the integer on the wire. A response names neither
its command nor its parameter; if the request is not known, the text states what is open.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

from bus.catalogue.parameters import PARAMETERS
from bus.catalogue.values import StatusBits, status_bits
from bus.errors import unit_error
from bus.messages import Message, parameter_name
from bus.settings import Dialect
from bus.wire.commands import (
    TRAITS,
    Ack,
    IllegalRequest,
    Nak,
    ParameterReply,
    ReadParameterRequest,
    ReadStatusRequest,
    Reply,
    Request,
    SetAndExecuteSpeedRequest,
    StageSpeedRequest,
    StatusReply,
    WriteAnalogOutputRequest,
    WriteOutputRequest,
    WriteParameterRequest,
    is_secret,
    parse_reply,
    parse_request,
)
from bus.wire.framing import ACK, NAK, FrameDecoder, Noise, Received, ReceivedFrame, checksum

Json: TypeAlias = "bool | int | str | list[Json] | dict[str, Json] | None"

_PARAMETER_VALUE_WIDTHS = (1, 2, 4)
Detail: TypeAlias = "tuple[str, dict[str, Json], Message]"
"""The kind, the fields and the meaning of a frame."""


@dataclass(frozen=True, slots=True)
class Described:
    """A frame, perhaps without its checksum. ``fields`` show a secret, ``meaning`` does not."""

    uid: int
    kind: str
    fields: dict[str, Json]
    meaning: Message
    wire: bytes
    checksum_ok: bool = True
    request: Request | None = None
    """The parsed request, if the frame is one."""

    def as_json(self) -> dict[str, Json]:
        """Return the object of ``lineside decode --json``."""
        names = ("uid", "kind", "fields", "checksum_ok")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, slots=True)
class DescribedNoise:
    """The description of bytes that are not a frame."""

    wire: bytes
    meaning: Message


class Describer:
    """The describer of frames in their order, so that a response is read in the context of its request."""

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self._request: Request | None = None

    def describe(self, received: Iterable[Received]) -> list[Described | DescribedNoise]:
        """Describe everything but the doubled checksum bytes, which belong to the frames before them."""
        described: list[Described | DescribedNoise] = []
        for item in received:
            if isinstance(item, ReceivedFrame):
                frame = _described(item.body, item.wire, self._dialect, self._request)
                self._request = frame.request
                described.append(frame)
            elif isinstance(item, Noise):
                described.append(self._noise(item))
        return described

    def _noise(self, noise: Noise) -> Described | DescribedNoise:
        if not noise.body:
            reason = Message(f"noise_{noise.reason.value}")
            return DescribedNoise(noise.data, Message.of("noise", count=len(noise.data), reason=reason))
        frame = _described(noise.body, noise.data, self._dialect, None)
        right = f"{checksum(noise.body):02X}"
        meaning = Message.of("frame_checksum_wrong", right=right, frame=frame.meaning)
        return replace(frame, meaning=meaning, checksum_ok=False, request=None)


def describe_bytes(data: bytes, dialect: Dialect | None = None) -> list[Described | DescribedNoise]:
    """Describe all frames and noise in ``data``, in order."""
    dialect = dialect or Dialect()
    decoder = FrameDecoder(dialect)
    return Describer(dialect).describe([*decoder.feed(data), *decoder.flush()])


def _described(body: bytes, wire: bytes, dialect: Dialect, request: Request | None) -> Described:
    """Describe the ``body`` of a good frame; ``request`` is the one that it may respond to."""
    if body[1] == ACK or body[1] == NAK:
        kind, fields, meaning = _response_detail(body, dialect, request)
        return Described(body[0], kind, fields, _of_unit(body[0], meaning), wire)
    parsed: Request | None = None
    try:
        parsed = parse_request(body, dialect)
        kind, fields, meaning = _request_detail(parsed)
    except IllegalRequest as error:
        fields = {"command": f"{body[1]:02X}", "data": body[2:].hex(" ").upper()}
        kind, meaning = "unknown", error.message
    return Described(body[0], kind, fields, _of_unit(body[0], meaning), wire, request=parsed)


# --- requests ------------------------------------------------------------------------------------


def _request_detail(request: Request) -> Detail:
    kind = TRAITS[request.COMMAND].name
    match request:
        case ReadParameterRequest(number=number):
            meaning = Message.of("request_read_parameter_number", parameter=parameter_name(number))
            return kind, {"number": number, "name": _name(number)}, meaning
        case WriteParameterRequest(number=number, raw=raw):
            shown = _unless_secret(request, raw)
            meaning = Message.of("request_write_parameter_to", parameter=parameter_name(number), raw=shown)
            return kind, {"number": number, "name": _name(number), "raw": raw}, meaning
        case (
            StageSpeedRequest(raw=raw)
            | SetAndExecuteSpeedRequest(raw=raw)
            | WriteAnalogOutputRequest(raw=raw)
        ):
            return kind, {"raw": raw}, Message.of(f"request_{kind}_to", raw=raw)
        case WriteOutputRequest(output=output, on=on):
            code = "request_write_output_on" if on else "request_write_output_off"
            return kind, {"output": output, "on": on}, Message.of(code, output=output)
        case _:
            return kind, {}, Message(f"request_{kind}")


def _name_of(request: Request) -> Message:
    return Message(f"request_{TRAITS[request.COMMAND].name}")


def _of_unit(unit: int, meaning: Message) -> Message:
    whose = Message.of("frame_unit", unit=unit) if unit else Message("frame_all_units")
    return Message.of("frame", unit=whose, meaning=meaning)


def _unless_secret(request: Request, raw: int) -> int | Message:
    return Message("value_hidden") if is_secret(request) else raw


def _name(number: int) -> str | None:
    return PARAMETERS[number].name if number in PARAMETERS else None


# --- responses -----------------------------------------------------------------------------------


def _response_detail(body: bytes, dialect: Dialect, request: Request | None) -> Detail:
    reply = parse_reply(request, body, dialect) if request is not None else None
    if reply is not None and request is not None:
        return _in_context(reply, request, dialect)
    mark, data = body[1], body[2:]
    if mark == NAK and len(data) == 1:
        return _nak(data[0], None)
    status = parse_reply(ReadStatusRequest(body[0]), body, dialect)
    if isinstance(status, StatusReply):
        return _status(status, dialect)
    return _without_request(mark, data)


def _in_context(reply: Reply, request: Request, dialect: Dialect) -> Detail:
    match reply:
        case StatusReply():
            return _status(reply, dialect)
        case Nak():
            return _nak(reply.code, request)
        case ParameterReply() if isinstance(request, ReadParameterRequest):
            number, shown = request.number, _unless_secret(request, reply.raw)
            value = Message.of("parameter_response", parameter=parameter_name(number), raw=shown)
            return "parameter_value", {"number": number, "name": _name(number), "raw": reply.raw}, value
        case _:
            data = reply.data if isinstance(reply, Ack) else b""
            code = "request_accepted_with_value" if data else "request_accepted"
            return "ack", _data_fields(data), Message.of(code, request=_name_of(request))


def _without_request(mark: int, data: bytes) -> Detail:
    if mark == ACK and not data:
        return "ack", {}, Message("ack")
    if mark == ACK and len(data) in _PARAMETER_VALUE_WIDTHS:
        meaning = Message.of("ack_with_value", raw=int.from_bytes(data, "big"))
        return "parameter_value", _data_fields(data), meaning
    meaning = Message.of("ack_of_wrong_length" if mark == ACK else "nak_of_wrong_length", count=len(data))
    return "unknown", {"data": data.hex(" ").upper()}, meaning


def _data_fields(data: bytes) -> dict[str, Json]:
    return {"raw": int.from_bytes(data, "big"), "width": len(data)} if data else {}


def _nak(code: int, request: Request | None) -> Detail:
    error = unit_error(code)
    if request is None:
        meaning = Message.of("nak", error=error)
    else:
        meaning = Message.of("nak_to_request", request=_name_of(request), error=error)
    return "nak", {"unit_error": code, "name": str(error)}, meaning


def _status(reply: StatusReply, dialect: Dialect) -> Detail:
    bits = status_bits(reply.outputs, reply.inputs, dialect.estop_healthy)
    fields: dict[str, Json] = {
        "commanded_raw": reply.commanded,
        "actual_raw": reply.actual,
        "analog_raw": reply.analog,
        "at_speed": bits.at_speed,
        "remote": bits.remote,
        "outputs": list(bits.outputs),
        "inputs": {**bits.inputs},
    }
    meaning = Message.of(
        "status_response",
        commanded=reply.commanded,
        actual=reply.actual,
        analog=reply.analog,
        state=list(_state(bits)),
    )
    return "status", fields, meaning


def _state(bits: StatusBits) -> Iterator[Message]:
    yield Message("status_at_speed" if bits.at_speed else "status_off_speed")
    yield Message("status_remote" if bits.remote else "status_not_remote")
    for number, on in enumerate(bits.outputs, start=1):
        if on:
            yield Message.of("status_output", output=number)
    yield from (Message(f"status_{name}") for name, on in bits.inputs.items() if on)
