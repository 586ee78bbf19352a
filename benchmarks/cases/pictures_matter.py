"""What drawn pictures are worth: panels from two pictures of a draped garment, by one network trained on three inputs.

    python -m benchmarks.run pictures_matter --count 12 --steps 30 --size 64 --device cpu

The inputs show the same garments from the front and from behind:

- ``plain``: the stored pictures, fixed cameras, a colour for each panel; the same at every reading;
- ``grey``: grey cloth in studio light, cameras drawn anew for each reading;
- ``drawn``: cloth, prints, people, cameras, lights and places drawn anew for each reading.

Each network has the same first weights, steps and order of draws. All are tested on garments of other designs, as
``plain``, ``grey`` and ``drawn`` pictures and as ``held_out`` ones: prints (checks, tartan, flowers), kinds of cloth
(satin, crepe, flannel, ponte), skin tones, places (rooms), cameras (yaw, pitch, focal length) and lights (azimuth,
colour, contrast) that no training drew. ``gap_to_X_on_Y``: the score of the network trained on ``drawn`` minus that of
the network trained on X, both tested on Y, with a 95 % interval (bootstrap over garments, paired).
"""
