"""Inverse problems: parameters with uncertainty from measured records."""
