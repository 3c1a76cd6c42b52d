"""From the store to the points of a chart."""
