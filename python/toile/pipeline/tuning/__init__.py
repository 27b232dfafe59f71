"""Before a long job: every quality tried on few frames of the capture, what it shows, and what the whole job would take.

trial      registers frames from five places of the sequence in a process of its own, and what that took
forecast   from that: hours, disk and memory of all frames, on this machine and on workers of one core
heldout    again without some cameras, and how their labels and masks agree with what was registered
fit        whether each garment's template is of the size and cut that the capture shows
page       all of it, with pictures side by side
"""

from .tune import Tuned, tune

__all__ = ["Tuned", "tune"]
