"""What is said of unit replacement."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "swap_not_begun": "no swap of unit {unit} is started; start it first",
    "swap_under_way": ("{who} has already started a swap of unit {unit}; continue it or cancel it first"),
    "swap_without_set": (
        "this swap has no set to restore from; enter the parameter sheet, or cancel the swap"
    ),
    "spare_not_chosen": "choose the source of the parameters; the swap was not started",
}
