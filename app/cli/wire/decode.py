"""``lineside decode``: the meaning of the frames in some bytes."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import click

from app.cli.ending import complain
from app.cli.options import PATH, json_option
from app.line.commands.api.trace_file import is_trace_line, parse_trace_line
from bus.contract import Frame
from bus.errors import CallerError
from bus.messages import Message
from bus.settings import Dialect
from bus.wire.describe import Described, DescribedNoise, Describer, describe_bytes
from bus.wire.framing import FrameDecoder

_SEPARATORS = re.compile(r"[\s,;:\[\]]+|0[xX]|\\x")
_HEX = re.compile(r"(?:[0-9a-fA-F]{2})+")
_STANDARD_INPUT = "-"


@click.command
@click.argument("hex_bytes", nargs=-1, metavar="HEX…", help="Bytes as hex; - reads standard input.")
@click.option("--file", type=PATH, help="A trace file, or a file of hex.")
@json_option
def decode(hex_bytes: tuple[str, ...], file: Path | None, as_json: bool) -> None:
    """Decode frames. Exit 0, 1 when no frame is valid, 2 when the bytes are not hex."""
    found = decode_text(_given_text(hex_bytes, file))
    frames = [item for item in found if isinstance(item, Described)]
    if as_json:
        click.echo(json.dumps([frame.as_json() for frame in frames]))
    else:
        for item in found:
            click.echo(f"{item.wire.hex(' ').upper()}\n    {item.meaning}")
    if not any(frame.checksum_ok for frame in frames):
        complain(Message("no_valid_frame"))
        raise click.exceptions.Exit(1)


def decode_text(text: str) -> list[Described | DescribedNoise]:
    """The content of a trace or a run of hex. Raises CallerError when it is neither."""
    lines = [line for line in text.splitlines() if line.strip()]
    if any(is_trace_line(line) for line in lines):
        return _decode_trace([parse_trace_line(line) for line in lines])
    return describe_bytes(parse_hex(text))


def parse_hex(text: str) -> bytes:
    """Bytes from hex in any case, with or without 0x, blanks, commas, brackets.

    Raises CallerError naming the invalid part.
    """
    tokens = [token for token in _SEPARATORS.split(text) if token]
    if not tokens:
        raise CallerError(Message("bytes_missing"))
    for token in tokens:
        if not _HEX.fullmatch(token):
            raise CallerError(Message.of("bytes_malformed", text=token[:40]))
    return bytes.fromhex("".join(tokens))


def _decode_trace(traced: list[Frame]) -> list[Described | DescribedNoise]:
    """Each direction is a separate stream; a response is decoded with the request before it."""
    dialect = Dialect()
    describer = Describer(dialect)
    streams = {"out": FrameDecoder(dialect), "in": FrameDecoder(dialect)}
    described = [
        item for frame in traced for item in describer.describe(streams[frame.direction].feed(frame.data))
    ]
    for stream in streams.values():
        described += describer.describe(stream.flush())
    return described


def _given_text(hex_bytes: tuple[str, ...], file: Path | None) -> str:
    if file is not None:
        if hex_bytes:
            raise CallerError(Message("bytes_and_file"))
        return file.read_text(encoding="utf-8", errors="replace")
    if hex_bytes == (_STANDARD_INPUT,):
        return sys.stdin.read()
    return " ".join(hex_bytes)
