"""Parsing of large input beside the event loop.

One thread for all of it: two that compute would each take a third of the time from the loop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_THREAD = ThreadPoolExecutor(1, thread_name_prefix="parsing")


async def parse_apart(parse: Callable[[], T]) -> T:
    """What ``parse`` returns or raises; it runs after all that was given before."""
    return await asyncio.get_running_loop().run_in_executor(_THREAD, parse)
