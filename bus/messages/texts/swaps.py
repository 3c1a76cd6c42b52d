"""What is said of unit replacement."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "swap_not_begun": "no swap of unit {unit} has been begun; begin it first",
    "swap_under_way": "{who} has begun a swap of unit {unit} already; go on with it or leave it first",
    "swap_without_set": "this swap has no set to restore from; enter the sheet, or leave it",
    "spare_not_chosen": "choose what the spare shall become; nothing was begun",
}
