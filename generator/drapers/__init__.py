"""Drapers: in this process, or in one process for each device that garments from any number of workers share."""

from gcd_dataset.generator.drapers.address import DraperAddress, address_for, addresses_for
from gcd_dataset.generator.drapers.draper import Draper, DrapeReply, DrapeRequest
from gcd_dataset.generator.drapers.shared import SharedDraper

__all__ = ["DrapeReply", "DrapeRequest", "Draper", "DraperAddress", "SharedDraper", "address_for", "addresses_for"]
