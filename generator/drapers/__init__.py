"""Drapers: garments go in as requests and come back draped, from this process or from a process that workers share.

How a request travels from a worker to the draping process and back:

1. The main process creates an address for each draping process: a folder with a socket, and a lock that marks its owner
   (``address_for``). Workers inherit the address; nothing starts yet.
2. The first worker that connects starts the draping process (``DraperAddress.connect``); a file lock keeps others from
   starting a second one. Each GPU has two: one simulates while the other prepares a batch or takes pictures.
3. ``in_order`` in the worker prepares designs, sends up to ``at_once`` requests ahead, and returns results in order.
   ``SharedDraper`` computes the host data of each job, and the skin in each frame of a motion, and sends the request
   through the socket, with its arrays in a memory file.
4. In the draping process one thread for each connection reads requests into the ``RequestQueue``. Retries of a failed
   attempt go first, since later samples wait for them.
5. The main thread drapes all requests of all workers in one batch (``drape_unordered``): garments at rest leave it, and
   waiting requests take their worlds. ``PictureQueue`` moves and renders garments at rest several at a time.
6. A writer thread for each connection sends the replies, in order of completion, so a worker that does not read delays
   no other. The reply carries the request's number, by which ``in_order`` finds its work.
7. A worker that dies only loses its own requests. An error in the draping process is sent to every worker, which raises
   ``DrapeError``; after a kill they raise it when the socket closes. The next connection starts a new process. The
   draping process ends when its owner's lock is released, however the owner ends.

Without a GPU each worker drapes on its CPU by itself (``LocalDraper``). The tasks of a Ray cluster share such processes
too.
"""

from gcd_dataset.generator.drapers.address import DraperAddress, SharedDraper, address_for, addresses_for
from gcd_dataset.generator.drapers.draper import Draper, DrapeReply, DrapeRequest

__all__ = ["DrapeReply", "DrapeRequest", "Draper", "DraperAddress", "SharedDraper", "address_for", "addresses_for"]
