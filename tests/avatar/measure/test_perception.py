"""What people see of a picture: exact cases, and what each measure is blind to on purpose."""

import numpy as np
import pytest

from toile.avatar.measure.metrics import C1
from toile.avatar.measure.perception import FLAT, LETTER, WEIGHTS, SeenSums, legibility, seen

SIZE, MM = 192, 4.0  # [px], [mm a pixel]
WHOLE = np.ones((SIZE, SIZE), bool)


def print_of(seed=0, size=SIZE):
    """Blocks of 24 mm in random greys: (H,W,3)."""
    blocks = np.random.default_rng(seed).random((-(-size // 6), -(-size // 6)))
    return np.repeat(np.kron(blocks, np.ones((6, 6)))[:size, :size, None], 3, axis=2)


def test_a_picture_is_wholly_like_itself():
    image = print_of()
    assert seen(image, image, WHOLE, WHOLE, MM).measures == pytest.approx(
        {"ms_ssim": 1, "gradient_similarity": 1, "legibility": 1},
        abs=0.02,  # a window's noise is taken off the last
    )


def test_other_brightness_costs_what_the_coarsest_scale_says():
    image = np.full((SIZE, SIZE, 3), 0.5)
    found = seen(image + 0.1, image, WHOLE, WHOLE, MM).measures
    luminance = (2 * 0.5 * 0.6 + C1) / (0.5**2 + 0.6**2 + C1)
    assert found["ms_ssim"] == pytest.approx(luminance ** WEIGHTS[-1])
    assert found["gradient_similarity"] == pytest.approx(1) and found["legibility"] is None  # no print


def test_an_edge_that_is_missing_has_its_closed_form():
    edge = np.zeros((16, 16, 3))
    edge[:, 8:] = 0.5  # Prewitt: 0.5 on either side of it at half the size
    away = np.zeros((16, 16), bool)
    away[:, 4:12] = True
    found = seen(np.zeros_like(edge), edge, away, away, MM).measures["gradient_similarity"]
    assert found == pytest.approx((2 + 2 * FLAT / (0.5**2 + FLAT)) / 4)


@pytest.mark.parametrize(("shift", "legible"), [((2, 0), True), ((-1, 2), True), ((5, 0), False), ((0, -6), False)])
def test_a_print_is_read_a_centimetre_off_and_no_farther(shift, legible):
    image = print_of()
    moved = np.roll(image, shift, axis=(0, 1))
    inner = np.zeros_like(WHOLE)
    inner[20:-20, 20:-20] = True
    found = legibility(moved, image, inner, MM).mean()
    assert found > 0.97 if legible else found < 0.8


def test_a_print_is_read_in_a_window_of_five_centimetres():
    """A bright square of 5 pixels on plain cloth: as far as the window reaches from it there is something to read."""
    image = np.full((SIZE, SIZE, 3), 0.5)
    image[94:99, 94:99] = 1.0
    read = len(legibility(image, image, WHOLE, MM))
    assert (LETTER / MM + 4) ** 2 < read < (LETTER / MM + 6) ** 2


def test_a_fainter_print_is_read_and_none_or_another_is_not():
    image = print_of()
    faint = legibility(0.5 + 0.5 * (image - 0.5), image, WHOLE, MM).mean()
    none = legibility(np.full_like(image, 0.5), image, WHOLE, MM).mean()
    other = legibility(print_of(1), image, WHOLE, MM).mean()
    assert faint > 0.98 and abs(none) < 1e-9 and other < 0.4


def test_what_lies_outside_the_garment_does_not_make_it_legible():
    image, cloth = print_of(), np.zeros_like(WHOLE)
    cloth[60:120, 60:120] = True
    shown = np.where(cloth[..., None], print_of(1), image)
    assert legibility(shown, image, cloth, MM).mean() < 0.4


def test_sums_of_two_pictures_are_means_over_their_pixels():
    a, b, half = print_of(), print_of(1), WHOLE.copy()
    half[:, : SIZE // 2] = False
    one, two = seen(a, b, WHOLE, WHOLE, MM), seen(b, b, half, half, MM)
    both = SeenSums().add(one).add(two)
    assert (both.pixels == one.pixels + two.pixels).all()
    expected = (one.sums[-2] + two.sums[-2]) / both.pixels[-2]
    assert both.measures["gradient_similarity"] == pytest.approx(expected)
    assert SeenSums().measures == {"ms_ssim": None, "gradient_similarity": None, "legibility": None}
