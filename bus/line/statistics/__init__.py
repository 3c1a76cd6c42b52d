"""What passed on the wire, counted, kept and judged."""
