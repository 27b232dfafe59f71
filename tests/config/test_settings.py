"""Settings: every one says what it is, and no change of one is lost or misread."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import toile
from toile import _core
from toile.align.settings import AlignSettings
from toile.avatar.settings import AnimateSettings, AvatarSettings, train_preset
from toile.avatar.settings import preset as avatar_preset
from toile.config import (
    QUALITIES,
    Config,
    DressSettings,
    NricpSettings,
    Settings,
    VerdictSettings,
    changed,
    configured,
    from_options,
    listed,
    preset,
    read_config,
    read_set,
)
from toile.config.command import written
from toile.config.settings import UNITS
from toile.config.stereo import FuseSettings, MatchSettings
from toile.errors import UserError
from toile.measure.verdicts import REASONS
from toile.studio.options import StudioOptions

SOURCE = Path(toile.__file__).parent
KERNELS = {
    "track.skeleton": _core.SkeletonOptions,
    "inner.solver": _core.InnerOptions,
    "inner.untangle": _core.UntangleOptions,
    "segment.mrf": _core.MrfOptions,
    "dress.biharmonic": _core.BiharmonicOptions,
}


def group_of(settings, name):
    for part in name.split("."):
        settings = getattr(settings, part)
    return settings


def refused(change, also=()):
    with pytest.raises(UserError) as caught:
        configured(change, also)
    assert "\n" not in str(caught.value)
    return str(caught.value)


COMMANDS = [Config(), AlignSettings(), train_preset("standard"), StudioOptions()]


@pytest.mark.parametrize("settings", COMMANDS, ids=lambda s: type(s).__name__)
def test_every_setting_has_a_unit_and_a_meaning(settings):
    every = list(listed(settings))
    assert len(every) > 15
    for one in every:
        assert one.unit in UNITS, one.name
        assert len(one.meaning) > 5 and not re.search(r"\[.*\]$", one.meaning), one.name


def groups(settings):
    yield type(settings)
    for name in type(settings).model_fields:
        if isinstance(getattr(settings, name), Settings):
            yield from groups(getattr(settings, name))


def test_every_setting_is_read_somewhere():
    code = "\n".join(p.read_text() for p in SOURCE.rglob("*.py") if p.parent != SOURCE / "config")
    kernels = {type(group_of(Config(), name)) for name in KERNELS} | {NricpSettings, MatchSettings, FuseSettings}
    for group in {group for settings in COMMANDS for group in groups(settings)} - kernels:
        for name in group.model_fields:
            if name != "quality" and not (group is VerdictSettings and name in REASONS):  # the preset's name; a table's
                assert re.search(rf"\.{name}\b", code), f"{group.__name__}.{name}"


@pytest.mark.parametrize("name", KERNELS)
def test_kernel_options_have_the_core_s_names_and_defaults(name):
    core, face = (
        KERNELS[name](),
        {"joint_sigma", "other_joint_sigma", "joint_limit", "other_joint_limit", "joint_twist"},
    )
    for option, value in group_of(Config(), name).model_dump().items():
        if option not in face:
            assert value == getattr(core, option), option


def test_options_of_nricp_have_the_core_s_names_and_defaults():
    for option, value in NricpSettings().model_dump().items():
        assert np.array_equal(value, getattr(_core.NricpOptions(), option)), option


@pytest.mark.parametrize("quality", QUALITIES)
def test_what_a_run_saved_gives_the_same_settings_again(quality, tmp_path):
    config = changed(preset(quality), {"dress.contact": 0.02, "segment.opening.depth": (-0.001, 0.01)})
    saved = {"capture": "/somewhere", "frames": [1, 2], "settings": config.model_dump(mode="json")}
    path = tmp_path / "config.toml"
    path.write_text(tomli_w.dumps(saved))
    assert from_options(preset, None, path, None) == config
    aligned = AlignSettings(blurs=(0.01,), blur_steps=(2,))
    path.write_text(tomli_w.dumps(saved | {"align": {"settings": aligned.model_dump(mode="json")}}))
    assert from_options(lambda _: AlignSettings(), None, path, None, "align") == aligned
    assert from_options(preset, None, path, None) == config


def test_a_preset_yields_to_the_file_and_the_file_to_set(tmp_path):
    (tmp_path / "mine.toml").write_text('quality = "draft"\n[dress]\ncontact = 0.02\nfit_frames = 4\n')
    file, mine = tmp_path / "mine.toml", {"dress": {"contact": 0.02, "fit_frames": 4}}
    config = from_options(preset, None, file, ["dress.contact=0.03"])
    assert config == changed(preset("draft"), mine, {"dress.contact": 0.03}) and config.quality == "draft"
    assert from_options(preset, None, file, None) == changed(preset("draft"), mine)
    assert from_options(preset, "standard", file, None) == changed(preset("standard"), mine)
    assert from_options(preset, None, file, ["quality=standard"]) == changed(preset("standard"), mine)


def test_a_bad_name_is_told_with_where_it_stands(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("[settings]\nquality = 'draft'\n")  # no run's: those have frames
    with pytest.raises(UserError, match=f"--config {re.escape(str(file))}: settings: no such setting"):
        from_options(preset, None, file, None)
    with pytest.raises(UserError, match="--set dress.contat: no such setting; nearest: dress.contact"):
        from_options(preset, None, None, ["dress.contat=1"])


def test_a_quality_is_refused_where_settings_have_none(tmp_path):
    (tmp_path / "mine.toml").write_text('quality = "draft"\n')
    with pytest.raises(UserError, match="--set quality: no such setting"):
        from_options(lambda _: AlignSettings(), None, None, ["quality=draft"], "align")
    with pytest.raises(UserError, match="mine.toml: quality: no such setting"):
        from_options(lambda _: AlignSettings(), None, tmp_path / "mine.toml", None, "align")


@pytest.mark.parametrize("settings", [*COMMANDS, AnimateSettings()], ids=lambda s: type(s).__name__)
def test_set_reads_every_value_as_the_list_writes_it(settings):
    every = [one for one in listed(settings) if one.name != "quality"]
    assert (
        from_options(lambda _: settings, None, None, [f"{one.name}={written(one.default)}" for one in every])
        == settings
    )


def test_dotted_names_and_tables_are_one():
    a = configured({"track": {"nricp": {"fine_noise": 7.0}, "rest_smoothing": 2}})
    b = configured({"track.nricp.fine_noise": 7.0, "track.rest_smoothing": 2})
    assert a == b and a.track.nricp.iterations == Config().track.nricp.iterations


def test_an_unknown_name_is_refused_with_the_nearest():
    assert refused({"dress.contat": 1}) == "dress.contat: no such setting; nearest: dress.contact"
    assert refused({"dres": {"contact": 1}}) == "dres: no such setting; nearest: dress"
    assert refused({"contact": 1}).endswith("nearest: dress.contact")
    assert refused({"segment": {"evidence": {"dept_step": 1}}}).endswith("nearest: segment.evidence.depth_step")
    assert "there are quality" in refused({"qqq": 1})
    assert refused({"wokers": 2}, also=("workers",)).endswith("nearest: workers")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"dress.contact": "abc"}, "dress.contact = 'abc': should be a valid number"),
        ({"dress.contact": "0.01"}, "dress.contact = '0.01': should be a valid number"),
        ({"segment.views": True}, "segment.views = True: should be a valid integer"),
        ({"segment.views": 1.5}, "segment.views = 1.5: should be a valid integer"),
        ({"dress.contact": float("nan")}, "dress.contact = nan: should be a finite number"),
        ({"dress.contact": -1}, "dress.contact = -1: should be greater than or equal to 0"),
        ({"dress": 3}, "dress = 3: expected a table, its settings are dress.NAME"),
        ({"dress": {"contact": {"a": 1}}}, "dress.contact = {'a': 1}: should be a valid number"),
        ({"segment.opening.depth": [1]}, "segment.opening.depth.1 = (1,): Field required"),
        (
            {"verdict.two_sided_mm": [30.0, 12.0]},
            "verdict.two_sided_mm = (30.0, 12.0): expected two numbers of which the second is not the smaller one",
        ),
        (
            {"verdict.silhouette_iou": [0.8, 0.9]},
            "verdict.silhouette_iou = (0.8, 0.9): expected two numbers of which the second is not the larger one",
        ),
        (
            {"dress.placement.size": [2.0, 0.5]},
            "dress.placement.size = (2.0, 0.5): expected two numbers of which the second is not the smaller one",
        ),
        ({"prints.blurs": [0.01]}, "prints: blurs and blur_steps: expected as many of each"),
        ({"quality": "best"}, "--quality best: expected one of draft, standard"),
        ({"quality": 3}, "--quality 3: expected one of draft, standard"),
    ],
)
def test_a_value_that_a_setting_cannot_have_is_refused_by_name(change, message):
    assert refused(change) == message


def test_set_reads_toml_and_takes_the_rest_as_text():
    assert read_set(["dress.contact=0.01", "dress.fit_frames = 3", "data.crop=garment", "a=[1, 2]"]) == {
        "dress": {"contact": 0.01, "fit_frames": 3},
        "data": {"crop": "garment"},
        "a": [1, 2],
    }
    for word in ("dress.contact", "=3", " "):
        with pytest.raises(UserError, match="expected NAME=VALUE"):
            read_set([word])
    with pytest.raises(UserError, match="is given as a value too"):
        read_set(["dress=1", "dress.contact=2"])


def test_a_file_that_is_no_toml_is_refused_by_name(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("[dress\n")
    with pytest.raises(UserError, match=f"--config {re.escape(str(path))}: cannot be read as TOML"):
        read_config(path)
    path.write_text("a = " + "[" * 100_000)
    with pytest.raises(UserError, match="cannot be read as TOML"):
        read_config(path)
    with pytest.raises(UserError, match="No such file"):
        read_config(tmp_path / "missing.toml")


def test_joints_of_a_table_are_added_to_its_others():
    sigma = configured(read_set(["track.skeleton.joint_sigma.spine=0.3"])).track.skeleton.joint_sigma
    assert sigma["spine"] == 0.3 and sigma["head"] == Config().track.skeleton.joint_sigma["head"]
    assert refused({"track.skeleton.joint_sigma.spine": "x"}).startswith("track.skeleton.joint_sigma.spine = 'x'")


def test_a_change_leaves_what_it_changes():
    before = DressSettings()
    after = changed(before, {"loop.bending": 3.0})
    assert before == DressSettings() and after.loop.bending == 3 and after.contact == before.contact


def test_presets_are_what_their_tables_say():
    assert preset("standard") == Config()
    assert preset("draft") != preset("standard")
    with pytest.raises(UserError, match="--quality fine: expected one of draft, standard; nothing measured is finer"):
        preset("fine")
    assert tomllib.loads(tomli_w.dumps(preset("draft").model_dump(mode="json")))["quality"] == "draft"


def test_train_asks_for_the_avatar_and_the_temporal_model():
    asked = from_options(train_preset, "draft", None, ["data.modes=3", "temporal.channels=9"])
    assert asked.avatar() == changed(avatar_preset("draft"), {"data.modes": 3})
    assert type(asked.avatar()) is AvatarSettings and asked.temporal.channels == 9


def test_studio_refuses_by_name_whoever_asks():
    for words, message in (["frames=0"], "frames is 0"), (["subject=naked"], "subject is 'naked'"):
        with pytest.raises(UserError, match=f"studio: {message}"):
            from_options(lambda _: StudioOptions(), None, None, words)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"data.texture_size": 100}, "data.texture_size = 100: expected a power of two"),
        ({"data.geometry_size": 24}, "data.geometry_size = 24: expected a power of two"),
        ({"network.ao_size": 48}, "network.ao_size = 48: expected a power of two"),
        ({"network.texture_step": 3}, "network.texture_step = 3: expected a power of two"),
        ({"network.texture_step": 64}, "network.texture_step: 64 of 512 texels: fewer than 16 are left to decode"),
        ({"data.image": [0, 32]}, "data.image.0 = 0: should be greater than or equal to 1"),
        ({"visibility_widths": [0.02, 0.0]}, "visibility_widths.1 = 0.0: should be greater than 0"),
    ],
)
def test_sizes_that_networks_cannot_have_are_refused_before_any_training(change, message):
    with pytest.raises(UserError) as error:
        changed(train_preset("standard"), change)
    assert str(error.value) == message
