"""The change tray: changes that a person gathers on several pages, reviews and sends together."""
