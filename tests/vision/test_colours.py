"""Colour models under wrong labels."""

import numpy as np

from toile.vision.colours import fit_colours

IDS = np.array([1, 3, 4], np.uint8)


def coloured_pixels(rng, count):
    """Skin, a blue shirt with cream print, brown trousers; shading and noise."""
    label = rng.integers(0, 3, count)
    base = np.array([[220, 170, 140], [60, 90, 180], [90, 70, 50]])[label].astype(float)
    printed = (label == 1) & (rng.random(count) < 0.3)
    base[printed] = [235, 230, 205]
    rgb = base * rng.uniform(0.4, 1.0, (count, 1)) + rng.normal(0, 3, (count, 3))
    return label, np.clip(rgb, 0, 255).astype(np.uint8)


def test_colour_models_learn_printed_shirt_from_labels_of_which_a_fifth_is_wrong():
    rng = np.random.default_rng(0)
    label, rgb = coloured_pixels(rng, 60_000)
    wrong = rng.random(len(label)) < 0.2
    given = np.where(wrong, rng.integers(0, 3, len(label)), label)
    model = fit_colours(rgb, given, IDS, 0.2, 4)
    fresh, picture = coloured_pixels(rng, 20_000)
    assert (model.evidence(picture).argmax(1) == fresh).mean() > 0.97


def test_evidence_is_finite_for_colours_never_seen():
    rng = np.random.default_rng(1)
    label, rgb = coloured_pixels(rng, 5000)
    model = fit_colours(rgb, label, IDS, 0.1, 2)
    cube = np.stack(np.meshgrid(*[[0, 1, 128, 254, 255]] * 3, indexing="ij"), -1).astype(np.uint8)
    assert np.isfinite(model.evidence(cube)).all()


def test_a_small_label_keeps_its_colours_where_most_pixels_that_are_given_it_are_wrong():
    """Hair is a fiftieth of the person, and patches of a third of all pixels carry any label: four in five hairs are none."""
    rng = np.random.default_rng(2)
    label, rgb = coloured_pixels(rng, 60_000)
    few = (label != 1) | (rng.random(len(label)) < 0.06)
    label, rgb = label[few], rgb[few]
    wrong = rng.random(len(label)) < 0.3
    given = np.where(wrong, rng.integers(0, 3, len(label)), label)
    assert (label[given == 1] == 1).mean() < 0.3
    model = fit_colours(rgb, given, IDS, 0.15, 4)
    fresh, picture = coloured_pixels(rng, 20_000)
    found = model.evidence(picture).argmax(1)
    assert (found == fresh).mean() > 0.95 and (found[fresh == 1] == 1).mean() > 0.9
