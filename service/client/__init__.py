"""A client of a joulemap service, with the words of the Python library: what a script writes, typed, and its errors."""

from joulemap.service.client.costmap import ServedCostMap
from joulemap.service.client.service import Client

__all__ = ["Client", "ServedCostMap"]
