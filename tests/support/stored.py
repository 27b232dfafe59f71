"""What a run's store holds, and its files that come to harm."""

from pathlib import Path

import numpy as np
import zarr

from toile.io.run import file_of


def arrays(run):
    """{name: array} of all that the store of a run holds."""
    group = zarr.open_group(str(Path(run) / "registered.zarr"), mode="r")
    return {name: item[...] for name, item in group.members(max_depth=None) if isinstance(item, zarr.Array)}


def stored_file(run, key, row=0):
    """The file of an array that a row lies in."""
    store = Path(run) / "registered.zarr"
    return file_of(store, key, zarr.open_group(str(store), mode="r")[key], row)


def flip(run, key, row):
    """Changes one byte of a row, and nothing else of its file."""
    path = stored_file(run, key, row)
    rows = zarr.open_group(str(Path(run) / "registered.zarr"), mode="r")[key].shards[0]
    data = bytearray(path.read_bytes())
    index = np.frombuffer(data[-16 * rows - 4 : -4], "<u8").reshape(
        rows, 2
    )  # of a shard: place and bytes of its chunks
    place, size = (int(x) for x in index[row % rows])
    data[place + size // 2] ^= 1
    path.write_bytes(data)


def cut(run, key, row):
    """Leaves half of the file that a row lies in."""
    path = stored_file(run, key, row)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def lose(run, key, row):
    """Removes the file that a row lies in."""
    stored_file(run, key, row).unlink()
