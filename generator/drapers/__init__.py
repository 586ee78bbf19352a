"""Drapers: in this process, or in one process for each device that garments from any number of workers share."""

from gcd_dataset.generator.drapers.draper import Draped, Draper, Order
from gcd_dataset.generator.drapers.place import Place, place_for, places_for
from gcd_dataset.generator.drapers.shared import SharedDraper

__all__ = ["Draped", "Draper", "Order", "Place", "SharedDraper", "place_for", "places_for"]
