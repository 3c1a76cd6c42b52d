"""``python -m bus --config FILE --bus NAME --app URL``: one bus worker as a separate process.

The token comes from the environment (LINESIDE_WORKER_TOKEN). A ``--child`` reads it from the first line of
its standard input, because ``ps`` can list a command line and an environment.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import structlog

from bus.configuration import ConfigurationError, load_bus
from bus.messages import Message
from bus.worker.service import run

TOKEN_VARIABLE = "LINESIDE_WORKER_TOKEN"
WRONG_USE = 2


def main(arguments: list[str] | None = None) -> int:
    """Run a worker; return 0 after a stop on request, 2 for wrong use."""
    os.umask(0o077)
    options = _parser().parse_args(arguments)
    token = sys.stdin.readline().strip() if options.child else os.environ.pop(TOKEN_VARIABLE, "")
    if not token:
        return _wrong(Message.of("worker_token_missing", variable=TOKEN_VARIABLE))
    try:
        bus = load_bus(options.config, options.bus)
    except ConfigurationError as error:
        return _wrong(error.message)
    structlog.contextvars.bind_contextvars(bus=bus.name)
    return run(bus, options.app, token, child=options.child)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bus", description="One Lineside bus worker.")
    parser.add_argument("--config", type=Path, required=True, help="lineside.toml")
    parser.add_argument("--bus", required=True, help="the name of the [[bus]]")
    parser.add_argument(
        "--app", required=True, action="append", help="a dashboard, for example http://127.0.0.1:8000"
    )
    parser.add_argument(
        "--child", action="store_true", help="token from standard input; leave when the parent is gone"
    )
    return parser


def _wrong(message: Message) -> int:
    print(message, file=sys.stderr)
    return WRONG_USE


if __name__ == "__main__":
    sys.exit(main())
