"""How long each kind of thing may take on a slow machine that does five other things besides.

A wait ends as soon as what it waits for is there: the limits cost time only in a test that fails.
"""

from __future__ import annotations

PAGE_S = 60.0
"""A page is loaded or changed, from what the server knows or learns from a unit that responds."""
UNIT_S = 80.0
"""A unit is read, lost, found (without response it is polled every 10 s) or at speed after a ramp of 20 s."""
CALL_S = 90.0
"""A call of the API; a command in it may take 30 s."""
COMMAND_S = 30.0
"""What a command may wait for the wire at most, by the contract; by default it is 2 s."""
START_S = 90.0
"""A process starts or ends."""
PROCEDURE_S = 150.0
"""Many exchanges, as of a restore, or a measure that is taken from time to time, as of a full disk."""

PAGE_MS, UNIT_MS, START_MS, PROCEDURE_MS = (1000 * each for each in (PAGE_S, UNIT_S, START_S, PROCEDURE_S))
