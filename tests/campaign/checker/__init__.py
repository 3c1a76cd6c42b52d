"""Judges a campaign from what was recorded: the wire, the clients, the faults, the database.

A program apart: it imports nothing of Lineside and decodes frames with ``frames``, so that a fault of the
product cannot hide in what checks it. ``python -m tests.campaign.checker FOLDER STORE BUS…`` prints each
violation and ends with 1 where there is one.
"""
