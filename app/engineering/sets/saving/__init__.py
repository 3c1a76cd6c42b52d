"""Reading sets from units: at once, on schedule, and before the first write of a day."""
