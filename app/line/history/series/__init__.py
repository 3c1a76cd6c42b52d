"""Readings as series: runs, intervals, gaps, rollups, scaling, downsampling. Pure."""
