"""Events at rest: appended within a budget, found by text, grouped for a page."""
