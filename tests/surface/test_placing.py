"""A template of others is laid on the body, by the region that carries its garment, or refused by name."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile import kernels
from toile.config import PlacementSettings
from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.mesh import read_mesh, write_mesh
from toile.io.template import read_template
from toile.measure.evaluate import evaluate
from toile.pipeline.run import register
from toile.scene import Mesh
from toile.stages.template import cut
from toile.surface.operators import compact, distance_to_polyline
from toile.surface.placing import check_near_body, place_template

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
QUARTER = Rotation.from_euler("z", 90, degrees=True).as_matrix()
Y_UP = Rotation.from_euler("x", -90, degrees=True).as_matrix()


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def shirt():
    return open_capture(SAMPLE).templates["tshirt"]


def worn(model, arm=0.32, low=0.16):
    """The body's surface from the hips to the neck, and the arms as far as `arm` [m] from the middle."""
    V = model.v_template
    x, z = np.abs(V[:, 0]), V[:, 2]
    inside = np.minimum(np.minimum(arm - x, z - low), 0.735 - z)
    V, F = cut(V, model.f, inside, 0.0)
    part = kernels.vertex_components(F, len(V))[F[:, 0]]
    return Mesh(*compact(V, F[part == np.bincount(part).argmax()]))


@pytest.fixture(scope="module")
def region(model):
    return worn(model)


def placed(model, mesh, region):
    return place_template(model, "tshirt", mesh, region, PlacementSettings())


def test_a_template_that_lies_on_the_body_is_left_to_the_bit(model, shirt, region):
    mesh, said = placed(model, shirt, region)
    assert np.array_equal(mesh.vertices, shirt.vertices) and mesh.faces is shirt.faces and said == []


@pytest.mark.parametrize("factor", [10, 100, 1000, 1 / 0.0254])
@pytest.mark.parametrize("R", [np.eye(3), Y_UP, QUARTER, QUARTER @ QUARTER, Y_UP @ QUARTER], ids=str)
def test_units_and_axes_are_found_and_said(model, shirt, region, factor, R):
    mesh, said = placed(model, Mesh(factor * shirt.vertices @ R.T, shirt.faces), region)
    assert np.linalg.norm(mesh.vertices - shirt.vertices, axis=1).max() < 0.06
    assert f"scaled by {1 / factor:.4g}" in said[0] and len(said) == 1
    assert ("axes x y z taken as" in said[0]) == (R != np.eye(3)).any()


def test_a_turned_template_is_turned_back_though_it_would_lie_on_the_body(model, shirt, region):
    """Its back in front: nowhere farther than some centimetres off."""
    mesh, said = placed(model, Mesh(shirt.vertices * [-1, -1, 1], shirt.faces), region)
    assert np.linalg.norm(mesh.vertices - shirt.vertices, axis=1).max() < 0.06 and "-x -y +z" in said[0]


def test_a_hem_about_two_legs_is_drawn_to_their_rims_and_one_far_above_them_refused(model, shirt):
    V = shirt.vertices
    down = np.clip(1 - (V[:, 2] - V[:, 2].min()) / 0.2, 0, 1)
    dress = Mesh(V - np.outer(0.25 * down, [0, 0, 1]), shirt.faces)
    legs = worn(model, low=dress.vertices[:, 2].min() + 0.02)
    assert len(kernels.boundary_loops(legs.faces)) == 5  # neck, arms, two legs
    assert np.array_equal(placed(model, dress, legs)[0].vertices, dress.vertices)
    higher = Mesh(V - np.outer(0.11 * down, [0, 0, 1]), shirt.faces)
    drawn, said = placed(model, higher, legs)
    assert "rims that lie apart were drawn to the capture's: hem 1" in said[-1] and said[-1].endswith(" mm")
    low = lambda mesh: min(rims(mesh), key=lambda rim: rim[:, 2].mean())
    about = np.sort([rim[:, 2].mean() for rim in rims(legs)])[:2].mean()
    assert abs(low(drawn)[:, 2].mean() - about) < 0.005 and abs(low(higher)[:, 2].mean() - about) > 0.1
    assert abs(low(drawn)[:, 0].mean()) < 0.02 and np.array_equal(drawn.faces, higher.faces)
    with pytest.raises(UserError, match="another kind of garment"):
        placed(model, shirt, legs)


def test_a_shirt_s_template_on_what_is_open_in_front_is_refused(model, shirt, region):
    V = region.vertices
    front = (np.abs(V[:, 0]) < 0.03) & (V[:, 1] < -0.02)
    jacket = Mesh(*compact(V, region.faces[~front[region.faces].any(1)]))
    with pytest.raises(UserError, match="hem and neck of the template are one opening in the capture"):
        placed(model, shirt, jacket)


@pytest.mark.parametrize("t", [(1, 0, 0), (0, 0, 0.82), (0.1, -0.2, 0.1)])
def test_a_template_about_another_origin_is_moved(model, shirt, region, t):
    mesh, said = placed(model, Mesh(shirt.vertices + np.array(t), shirt.faces), region)
    assert np.linalg.norm(mesh.vertices - shirt.vertices, axis=1).max() < 0.06 and "moved by" in said[0]


def test_faces_that_look_inwards_are_turned(model, shirt, region):
    for mesh in (Mesh(shirt.vertices, shirt.faces[:, ::-1]), Mesh(shirt.vertices * [-1, 1, 1], shirt.faces)):
        found, said = placed(
            model, Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces), shirt.uv, shirt.face_uv), region
        )
        assert "look inwards" in said[0] and np.array_equal(found.vertices, mesh.vertices)
        assert np.array_equal(found.faces, mesh.faces[:, ::-1])
        assert np.array_equal(found.face_uv, shirt.face_uv[:, ::-1])  # corners go with their faces


@pytest.mark.parametrize("factor", [0.02, 5e4])
def test_a_size_of_no_known_unit_is_refused(model, shirt, region, factor):
    with pytest.raises(UserError, match="garment tshirt: the template is .* times as large as the capture shows"):
        placed(model, Mesh(factor * shirt.vertices, shirt.faces), region)


@pytest.mark.parametrize("factor", [0.65, 1.4])
def test_a_template_sizes_off_is_made_to_fit(model, shirt, region, factor):
    mesh, said = placed(model, Mesh(factor * shirt.vertices, shirt.faces), region)
    assert np.linalg.norm(mesh.vertices - shirt.vertices, axis=1).mean() < 0.06 and "scaled by" in said[0]


def rims(mesh):
    return [mesh.vertices[loop] for loop in kernels.boundary_loops(mesh.faces)]


def test_rims_that_lie_apart_are_drawn_to_the_captures(model, shirt):
    """Sleeves that end 14 cm farther down the arm."""
    longer = worn(model, arm=0.43)
    mesh, said = placed(model, shirt, longer)
    assert "rims that lie apart" in said[-1] and "sleeve_left" in said[-1] and "neck" not in said[-1]
    off = [min(distance_to_polyline(rim, own).mean() for own in rims(mesh)) for rim in rims(longer)]
    assert max(off) < 0.07  # neck and hem are left to the frames


def test_a_hem_below_the_crotch_is_that_about_both_thighs(model, shirt):
    """The body's surface that carries a long shirt ends about each thigh, in two rims for one hem."""
    V = shirt.vertices.copy()
    low = V[:, 2] < 0.3
    V[low, 2] = 0.3 - 2.2 * (0.3 - V[low, 2])
    hem = V[:, 2].min()
    region = worn(model, low=hem)
    assert len(kernels.boundary_loops(region.faces)) == 5
    mesh, said = placed(model, Mesh(V, shirt.faces), region)
    assert np.array_equal(mesh.vertices, V) and said == []


def test_a_long_sleeve_is_refused_with_both_lengths(model, shirt):
    with pytest.raises(UserError, match=r"loop sleeve_\w+ .*ends 0\.\d+ m from upperarm01.*ends 0\.\d+ m.*another cut"):
        placed(model, shirt, worn(model, arm=0.52))


def test_a_garment_of_another_kind_is_refused_by_its_openings(model, shirt):
    """A one-piece: the shirt's hem is nowhere, two legs are strange."""
    with pytest.raises(UserError, match="garment tshirt: .*"):
        placed(model, shirt, worn(model, low=-0.3))


def test_what_is_covered_must_lie_on_the_body(model, shirt):
    check_near_body(model, "tshirt", shirt, PlacementSettings())
    with pytest.raises(UserError, match="lies .* m from the body"):
        check_near_body(model, "tshirt", Mesh(10 * shirt.vertices, shirt.faces), PlacementSettings())


def foreign(name, data):
    """A foreign T-shirt as it comes."""
    if name == "diffcloth":
        return read_template(data / "diffcloth_tshirt" / "0.obj", "shirt").mesh
    whole = read_mesh(data / "makehuman_clothes" / name / f"{name}.obj")
    part = kernels.vertex_components(whole.faces, len(whole.vertices))[whole.faces[:, 0]]
    V, F = compact(whole.vertices, whole.faces[part == 0])
    return Mesh(V, F)


FOREIGN = ("male_casualsuit04", "female_casualsuit01", "diffcloth")


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_shirts_are_laid_on_the_body_from_their_own_units_and_axes(model, region, name, shared_data):
    mesh, said = placed(model, foreign(name, shared_data), region)
    assert region.index.closest(mesh.vertices)[3].mean() < 0.03
    assert "scaled by 0.1, its axes x y z taken as +x +z -y" in said[0]


@pytest.mark.slow(seconds=60)
@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_shirts_are_registered(name, shared_data, tmp_path):
    capture = shutil.copytree(SAMPLE, tmp_path / "capture")
    write_mesh(capture / "templates" / "tshirt.obj", foreign(name, shared_data))
    outcome = register(capture, tmp_path / "run", quality="draft", frames=(0, 3))
    assert outcome.ok == (0, 3) and any("scaled by 0.1" in warning for warning in outcome.warnings)
    shirt = evaluate(tmp_path / "run")["all"]["garment"]["tshirt"]
    assert shirt["surface_mm"] < 2.5 and shirt["boundary_all_mm"] < 10
