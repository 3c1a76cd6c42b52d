"""``/metrics``: what the workers, the wire and the people do, for Prometheus."""
