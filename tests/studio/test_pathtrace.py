"""The path tracer: same camera as masks and labels, a coat that grazing views see, prints that stick to the cloth."""

import numpy as np
import pytest

from toile.studio.cameras import make_cameras
from toile.studio.pictures import OuterSurface

mitsuba = pytest.importorskip("mitsuba")


@pytest.fixture(scope="module")
def look(body, cut):
    from toile.studio.paint import Appearance

    return Appearance("logo", body, [("tshirt", cut[0])], np.random.default_rng(0))


@pytest.fixture(scope="module")
def tracer(body, cut, look):
    from toile.io.body import load_body_model
    from toile.studio import pathtrace

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pathtrace, "BODY_TEXTURE", 256)
        yield pathtrace.PathTracer(look, body, load_body_model("anny"), [cut[1]], samples=4)


@pytest.fixture(scope="module")
def dressed(body, cut):
    lift = np.array([0, 0, -body.rest[:, 2].min()])
    return OuterSurface(body.rest + lift, body.model.f, cut[0] + lift, cut[1])


@pytest.fixture(scope="module")
def scene(tracer, dressed):
    return tracer.scene(dressed)


def test_rays_through_pixel_centres_hit_what_the_camera_projects_there(tracer, scene, dressed):
    from toile import kernels

    for camera in make_cameras(3, 64, np.random.default_rng(1), span=2.0, pinhole=True):
        sensor = tracer.sensor(camera, slice(0, 64), slice(0, 64))
        raster = kernels.raster(camera.to_camera(dressed.vertices), dressed.faces, camera.K, (64, 64))
        hits = 0
        for r, c in np.argwhere(raster.face >= 0)[::11]:
            ray, _ = sensor.sample_ray(0, 0.5, [(c + 0.5) / 64, (r + 0.5) / 64], [0.5, 0.5])
            point = np.array(scene.ray_intersect(ray).p)
            uv, depth = camera.project(point)
            assert np.abs(uv - [c + 0.5, r + 0.5]).max() < 1e-3
            hits += abs(depth - raster.depth[r, c]) < 1e-4
        assert hits > 10 and hits >= len(np.argwhere(raster.face >= 0)[::11]) - 1


def test_same_seed_same_bits_whatever_the_threads_and_another_seed_other_noise(tracer, scene, dressed):
    import drjit

    camera = make_cameras(1, 64, np.random.default_rng(1), pinhole=True)[0]
    images = []
    for threads in (1, 3):
        drjit.set_thread_count(threads)
        images.append(tracer.image(scene, dressed, camera, 5))
    other = tracer.image(scene, dressed, camera, 6)
    assert np.array_equal(images[0], images[1])
    assert not np.array_equal(images[0], other) and np.abs(images[0] - other).mean() < 0.05


def test_bands_leave_out_nothing_but_the_wall(tracer, scene, dressed, monkeypatch):
    from toile.studio import pathtrace

    camera = make_cameras(2, 64, np.random.default_rng(1), span=3.0, pinhole=True)[1]
    outside = np.ones((64, 64), bool)
    for row, col in pathtrace.bands(np.concatenate([dressed.vertices, pathtrace.plate_border()]), camera):
        outside[row, col] = False
    assert 0.2 < outside.mean() < 0.98
    monkeypatch.setattr(pathtrace, "bands", lambda points, camera: [(slice(0, 64), slice(0, 64))])
    whole = tracer.image(scene, dressed, camera, 5)
    assert np.abs(whole - pathtrace.to_srgb(np.array(pathtrace.AMBIENT)))[outside].max() < 1e-5


def test_the_clear_coat_reflects_more_at_grazing_angles(tracer):
    """A sheet under an even sky: what the coat adds to a black print grows towards the rim as Fresnel's law says."""
    from toile.studio import pathtrace

    mi = tracer.mi
    bsdf = mi.load_dict(pathtrace.coat({"type": "rgb", "value": 0.0}, pathtrace.COAT))
    interaction = mi.SurfaceInteraction3f()
    sampler = mi.load_dict({"type": "independent", "sample_count": 4096})
    sampler.seed(0, 1)

    def reflectance(degrees):
        a = np.radians(degrees)
        interaction.wi = [np.sin(a), 0, np.cos(a)]
        draw = lambda: bsdf.sample(mi.BSDFContext(), interaction, sampler.next_1d(), sampler.next_2d())[1]
        return float(np.mean([np.array(draw())[0] for _ in range(4000)]))

    straight, slanting, grazing = (reflectance(d) for d in (0, 60, 80))
    assert 0.03 < straight < 0.06  # ((n - 1) / (n + 1))^2 = 0.04
    assert slanting > 1.5 * straight and grazing > 3 * straight


def test_the_print_sticks_to_the_cloth(look, cut):
    """Where faces do not straddle front and back, the atlas gives what the own rasteriser paints."""
    from toile.studio.paint import TEXTURE, bilinear
    from toile.studio.pathtrace import PrintedMesh

    V, F = cut
    shirt = look.prints[0]
    mesh = PrintedMesh(shirt, F)
    assert np.array_equal(mesh.vertex[mesh.faces], F)
    side = shirt.flat[F, 1] >= 0
    plain = np.nonzero(side.all(1) | ~side.any(1))[0]
    bary = np.random.default_rng(0).dirichlet(np.ones(3), len(plain))
    uv = np.einsum("fc,fcd->fd", bary, mesh.uv[mesh.faces[plain]])
    flat = np.einsum("fc,fcd->fd", bary, shirt.flat[F[plain]])
    print_only = np.concatenate(shirt.textures, 1)
    atlas = bilinear(print_only, uv[:, 0] * 2 * TEXTURE - 0.5, uv[:, 1] * TEXTURE - 0.5)
    painted = shirt.colours(flat)
    assert shirt.atlas().shape == print_only.shape == (TEXTURE, 2 * TEXTURE, 3)
    assert np.quantile(np.abs(atlas - painted).max(1), 0.95) < 0.15


def test_body_texture_has_skin_trousers_hair_and_eyes(tracer, look):
    colour, gloss = tracer.painted_body()
    assert colour.shape == (256, 256, 3) and np.isfinite(colour).all()
    assert {0.05, 0.4, 0.5, 0.6, 1.0} <= set(np.unique(gloss).round(2))
