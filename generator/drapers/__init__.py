"""Draping by another process: one for each device, which garments from any number of workers share."""

from gcd_dataset.generator.drapers.ahead import make_ahead
from gcd_dataset.generator.drapers.asking import Asking, Draped, Order
from gcd_dataset.generator.drapers.place import Place, place_for

__all__ = ["Asking", "Draped", "Order", "Place", "make_ahead", "place_for"]
