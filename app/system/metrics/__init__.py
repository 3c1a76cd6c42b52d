"""Metrics for Prometheus at ``/metrics``: workers, wire, commands, alarms, stores."""
