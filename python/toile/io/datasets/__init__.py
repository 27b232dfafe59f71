"""Public data sets, one file each: each says what it takes and what it leaves.

A reader `read(source, up)` gives a `Found` in metres; `up` "" is the data set's own or what its cameras hold up.
"""

from . import actorshq, dna_rendering, dress4d, goliath, mvhumannet

DATASETS = {
    "4d-dress": dress4d.read,
    "goliath": goliath.read,
    "actorshq": actorshq.read,
    "mvhumannet": mvhumannet.read,
    "dna-rendering": dna_rendering.read,
}
