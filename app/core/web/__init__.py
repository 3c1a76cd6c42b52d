"""The parts that every page and call shares: rendering, languages, problems, security headers, static
files."""
