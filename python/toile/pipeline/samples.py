"""Frames as the stages read them, and those that the preparation is made of: with 100 cameras of 12 megapixels one alone
takes 6 GB, so that no two pictures of them are held whole, and those that wait do so in files."""

from __future__ import annotations

import tempfile
from dataclasses import replace

import numpy as np

from ..errors import UserError, first_line
from ..frame_numbers import evenly
from ..io.files import naming
from ..io.status import Status
from ..stages import reconstruct
from ..surface.thinning import thinned
from ..vision.segmenters.asked import labelled
from ..vision.thin_pictures import thin_picture, thin_pictures
from ..vision.threads import parallel_map
from .blocks import raise_where_disk
from .scanning import make_scans

PICTURES = ("images", "masks", "labels", "certainty")  # fields of a Frame


def frame_of(capture, config, number, *thin):
    """A frame as the stages take it: its pictures labelled, its scan as dense as tracking asks. `thin`: see `Capture.frame`,
    of a scene without a network."""
    frame = capture.frame(number, *thin)
    return with_scan_of(frame if thin else labelled(capture, frame), config.track.scan_spacing)


def with_scan_of(frame, spacing):
    """The frame with its scan thinned, see `thinned`; itself where it has none."""
    return frame if frame.scan is None else replace(frame, scan=thinned(frame.scan, spacing))


def as_labels_see(frame, config):
    """The frame as labels and garments see it: its scan and its pictures thinned."""
    return thin_pictures(with_scan_of(frame, config.scan_spacing), config.picture_side)


def points_of(capture, config, frame):
    """Keypoints of a frame in space, those that it brings or else triangulated; None where it has none, or none that two
    cameras agree on."""
    if frame.keypoints is None and frame.points3d is None:
        return None
    points = frame.points3d or reconstruct.triangulate(frame.keypoints, capture.cameras, config.reconstruct)
    return points if np.isfinite(points.points).any() else None


def samples_of(capture, run, config, identities):
    """[(Frame, Points3D | None)] of the frames that the preparation is made of, as far as they can be read: their pictures
    thinned and in files of the folder RUN/prepared, and none of a scene without garments."""
    folder = run / "prepared"
    folder.mkdir(parents=True, exist_ok=True)

    def read(number):
        try:
            frame = _put_away(capture, config, number, folder)
            points = points_of(capture, config, frame)
        except Exception as error:
            raise_where_disk(error)
            return first_line(error)
        if frame.scan is None and points is None:
            return f"frame {number}: neither a scan nor keypoints that two cameras agree on"
        return frame, points

    chosen = identities.sampled
    failed = make_scans(capture, chosen, config, Status.of(run), identities)
    found = [*parallel_map(read, [number for number in chosen if number not in failed]), *failed.values()]
    samples = [sample for sample in found if not isinstance(sample, str)]
    if not samples:
        raise UserError(found[0])
    reconstruct.check_with_scans(samples, config.reconstruct)
    return samples


def sampled_frames(capture, count, frames):
    """Numbers of frames spread evenly, and as many of those with label images where others have none. Frames of keypoints alone are
    among them only where no other has more: they show no surface."""
    spread = evenly(frames, count)
    if not all(shows_surface(capture, number) for number in spread):
        frames = [number for number in frames if shows_surface(capture, number)] or frames
        spread = evenly(frames, count)
    if not capture.scene.garments or capture.scene.segmenter or all(capture.labelled(number) for number in spread):
        return spread
    return sorted({*spread, *evenly([number for number in frames if capture.labelled(number)], count)})


def shows_surface(capture, number):
    """Whether a frame brings a scan or pictures."""
    return (capture.folder(number) / "scan.ply").exists() or bool(capture.pictured(number))


def _put_away(capture, config, number, folder):
    """`frame_of`, its pictures thinned and in a nameless file of the folder that goes with the frame."""
    if not capture.scene.garments:
        frame = frame_of(capture, config, number, lambda picture: None)
        return replace(frame, **{name: {} for name in PICTURES})
    with naming(folder), tempfile.TemporaryFile(dir=folder) as file:

        def put(picture):
            picture, place = np.ascontiguousarray(thin_picture(picture, config.picture_side)), file.tell()
            file.write(picture.data)
            return place, picture.shape, picture.dtype

        network = capture.scene.segmenter  # it sees whole pictures
        frame = frame_of(capture, config, number, *([] if network else [put]))
        placed = {name: _each(put, of) if network else of for name in PICTURES for of in [getattr(frame, name)]}
        file.flush()
        data = np.asarray(np.memmap(file, np.uint8, "r")) if file.tell() else None

    def there(placed):
        place, shape, kind = placed
        return data[place : place + int(np.prod(shape)) * kind.itemsize].view(kind).reshape(shape)

    return replace(frame, **{name: _each(there, of) for name, of in placed.items()})


def _each(function, pictures):
    return {name: function(picture) for name, picture in pictures.items()}
