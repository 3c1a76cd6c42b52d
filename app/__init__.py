"""The side of people and time: pages, API, users, history, events. It never imports how bytes travel."""

from pathlib import Path

from bus.messages import add_texts

add_texts(Path(__file__).parent)
