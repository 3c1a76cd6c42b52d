"""The change tray: what a person gathers on several pages, reviewed and sent as one change."""
