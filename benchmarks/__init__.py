"""What Lineside costs and what it leaves of the wire, measured beside its peers in one run.

``make bench`` runs every table; ``python -m benchmarks wire screen`` runs some. ``python -m benchmarks
against COMMIT`` measures this tree and an earlier one in turns.
"""
