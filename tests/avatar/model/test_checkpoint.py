"""Checkpoints and the files of an avatar: whole, few, and refused with one clear message when they do not fit."""

import json

import pytest
import torch

from tests.support.small_disk import largest_file
from toile.avatar.model.checkpoint import (  # fmt: skip
    MODEL,
    Checkpoints,
    asked_before,
    begin,
    check_same,
    load_model,
    load_optimiser,
    read_facts,
    read_tensors,
    write_tensors,
)
from toile.avatar.settings import preset
from toile.errors import UserError, first_line


@pytest.fixture
def model():
    torch.manual_seed(0)
    return torch.nn.Linear(3, 2)


@pytest.fixture
def optimiser(model):
    optimiser = torch.optim.AdamW(model.parameters(), lr=0.1)
    model(torch.ones(3)).sum().backward()
    optimiser.step()
    return optimiser


def test_tensors_and_facts_come_back_to_the_bit(tmp_path):
    tensors = {
        "a": torch.tensor([0.1, float("nan"), -0.0]),
        "b": torch.arange(6).reshape(2, 3).T,
        "c": torch.tensor(True),
    }
    facts = {"loss": 0.1 + 0.2, "steps": [1, 2], "unit": "\u00b5"}
    write_tensors(tmp_path / "x.safetensors", tensors, facts)
    found, notes = read_tensors(tmp_path / "x.safetensors")
    assert notes == facts and list(tmp_path.iterdir()) == [tmp_path / "x.safetensors"]
    for name, tensor in tensors.items():
        assert found[name].dtype == tensor.dtype and torch.equal(found[name].nan_to_num(7), tensor.nan_to_num(7))


def test_tensors_that_a_disk_does_not_take_are_an_error_of_their_file(tmp_path):
    with largest_file(1000), pytest.raises(OSError) as raised:
        write_tensors(tmp_path / "x.safetensors", {"a": torch.zeros(1000)}, {})
    assert first_line(raised.value) == f"{tmp_path}/x.safetensors: File too large" and list(tmp_path.iterdir()) == []


def test_tensors_are_read_by_whom_other_files_are(tmp_path):
    (tmp_path / "other").touch()
    write_tensors(tmp_path / "x.safetensors", {"a": torch.zeros(1)}, {})
    assert (tmp_path / "x.safetensors").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_weights_and_moments_come_back(model, optimiser, tmp_path):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.write(5, model, optimiser, {"step": 5})
    tensors, facts = checkpoints.latest()
    other = torch.nn.Linear(3, 2)
    load_model(other, tensors)
    assert facts == {"step": 5} and torch.equal(other.weight, model.weight)
    fresh = torch.optim.AdamW(other.parameters(), lr=0.1)
    load_optimiser(fresh, tensors)
    for net, opt in ((model, optimiser), (other, fresh)):
        opt.zero_grad()
        net(torch.arange(3.0)).square().sum().backward()
        opt.step()
    assert torch.equal(other.weight, model.weight) and torch.equal(other.bias, model.bias)


def test_a_checkpoint_without_any_moments_is_refused(model, optimiser):
    tensors = {MODEL + name: value for name, value in model.state_dict().items()}
    with pytest.raises(UserError, match=r"^here: optimiser\.\*: is missing"):
        load_optimiser(optimiser, tensors, "here")


def test_a_checkpoint_without_the_moments_of_one_weight_is_refused_unless_its_phase_did_not_train_that(model, tmp_path):
    optimiser = torch.optim.AdamW([*model.parameters(), torch.nn.Parameter(torch.ones(1))], lr=0.1)
    model(torch.ones(3)).sum().backward()
    optimiser.step()
    Checkpoints(tmp_path).write(3, model, optimiser, {})
    tensors, _ = Checkpoints(tmp_path).latest()
    load_optimiser(optimiser, tensors)  # the third has none
    kept = {name: value for name, value in tensors.items() if not name.startswith("optimiser.1.")}
    with pytest.raises(UserError, match=r"^here: optimiser\.1\.step: is missing"):
        load_optimiser(optimiser, kept, "here")


def test_two_checkpoints_are_kept_and_an_abandoned_course_goes(model, optimiser, tmp_path):
    checkpoints = Checkpoints(tmp_path)
    for number in (0, 5, 10, 15):
        checkpoints.write(number, model, optimiser, {"step": number})
    assert checkpoints.numbers() == [10, 15]
    checkpoints.write(12, model, optimiser, {"step": 12})
    assert checkpoints.numbers() == [10, 12] and checkpoints.latest()[1] == {"step": 12}


def test_damaged_checkpoint_is_refused(model, optimiser, tmp_path):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.write(3, model, optimiser, {})
    path = tmp_path / "00000003.safetensors"
    for content in (path.read_bytes()[:-9], b"", b"\x80\x04N."):
        path.write_bytes(content)
        with pytest.raises(UserError, match="00000003.safetensors: not a file of toile's tensors.*without this file"):
            checkpoints.latest()


def test_weights_that_are_not_finite_are_refused_by_name(model, optimiser, tmp_path):
    tensors = {MODEL + name: value.clone() for name, value in model.state_dict().items()}
    first = next(iter(tensors))
    tensors[first].view(-1)[0] = float("nan")
    with pytest.raises(UserError, match=f"avatar: {first.removeprefix(MODEL)}: is not finite"):
        load_model(model, tensors, "avatar")


def test_checkpoint_of_another_architecture_is_refused(model, optimiser, tmp_path):
    Checkpoints(tmp_path).write(3, model, optimiser, {})
    tensors, _ = Checkpoints(tmp_path).latest()
    with pytest.raises(UserError, match=r"here: weight: shape \(2, 3\), this avatar has \(2, 4\)"):
        load_model(torch.nn.Linear(4, 2), tensors, "here")
    with pytest.raises(UserError, match=r"0.bias: shape None"):
        load_model(torch.nn.Sequential(torch.nn.Linear(3, 2)), tensors)


@pytest.mark.parametrize(
    "name, change",
    [
        ("optimiser.0.exp_avg", lambda moments: moments[:1].clone()),
        ("optimiser.1.exp_avg_sq", lambda moments: moments * float("nan")),
        ("optimiser.1.exp_avg", lambda moments: None),
        ("optimiser.7.step", lambda moments: torch.tensor(1.0)),
        ("optimiser.x", lambda moments: torch.tensor(1.0)),
    ],
)
def test_moments_that_are_not_an_optimisers_are_refused_by_name(model, optimiser, tmp_path, name, change):
    Checkpoints(tmp_path).write(3, model, optimiser, {})
    tensors, _ = Checkpoints(tmp_path).latest()
    tensors = {one: value for one, value in (tensors | {name: change(tensors.get(name))}).items() if value is not None}
    with pytest.raises(UserError, match=f"here: {name}: "):
        load_optimiser(torch.optim.AdamW(model.parameters()), tensors, "here")


def test_a_file_that_is_none_of_the_checkpoints_is_passed_over(model, optimiser, tmp_path):
    Checkpoints(tmp_path).write(3, model, optimiser, {})
    (tmp_path / "copy of 4.safetensors").write_bytes(b"")
    assert Checkpoints(tmp_path).numbers() == [3]


def test_another_scene_or_setting_is_named(tmp_path):
    asked = {"scene": "walk", "topology": {"layer body": "12"}, "settings": preset("draft").model_dump(mode="json")}
    assert begin(tmp_path, asked) and begin(tmp_path, asked)
    with pytest.raises(UserError, match='avatar.json: scene: holds "walk", asked is "talk": take another folder'):
        begin(tmp_path, asked | {"scene": "talk"})
    with pytest.raises(UserError, match='topology.layer body: holds "12", asked is "34"'):
        begin(tmp_path, asked | {"topology": {"layer body": "34"}})
    finer = preset("fine").model_dump(mode="json")
    with pytest.raises(UserError, match='settings.quality: holds "draft", asked is "fine"'):
        begin(tmp_path, asked | {"settings": finer})


def test_a_setting_that_an_older_version_did_not_know_has_its_default(tmp_path):
    asked = {"settings": preset("draft").model_dump(mode="json")}
    older = json.loads(json.dumps(asked))
    del older["settings"]["network"]["remainder"]
    (tmp_path / "avatar.json").write_text(json.dumps(older | {"steps": None}))
    assert begin(tmp_path, asked)
    asked["settings"]["network"]["remainder"] += 1
    with pytest.raises(UserError, match="settings.network.remainder: holds"):
        begin(tmp_path, asked)


def test_an_avatar_that_was_moved_finds_the_run_that_lies_in_it(tmp_path):
    asked = {"run": str(tmp_path / "old" / "aligned"), "settings": preset("draft").model_dump(mode="json")}
    facts = json.dumps(asked | {"frames": [1], "holdout": [], "steps": {}, "architecture": {}})
    for folder in (tmp_path / "new", tmp_path / "new" / "baseline"):
        folder.mkdir()
        (folder / "avatar.json").write_text(facts)
        assert read_facts(folder)["run"] == asked["run"]
    (tmp_path / "new" / "aligned").mkdir()
    for folder in (tmp_path / "new", tmp_path / "new" / "baseline"):
        assert read_facts(folder)["run"] == asked_before(folder)["run"] == str(tmp_path / "new" / "aligned")
    (tmp_path / "old" / "aligned").mkdir(parents=True)
    for folder in (tmp_path / "new", tmp_path / "new" / "baseline"):  # copied, it has its own
        assert read_facts(folder)["run"] == str(tmp_path / "new" / "aligned")


def test_a_run_that_was_moved_is_known_by_its_registration_and_another_is_refused(tmp_path):
    asked = {"run": "/old/run", "registration": "12", "settings": preset("draft").model_dump(mode="json")}
    begin(tmp_path, asked)
    assert begin(tmp_path, asked | {"run": "/new/run"}) and asked_before(tmp_path)["run"] == "/new/run"
    with pytest.raises(UserError, match='registration: holds "12", asked is "34"'):
        begin(tmp_path, asked | {"run": "/new/run", "registration": "34"})
    with pytest.raises(UserError, match="f: registration: it was trained with another one than there is now: take"):
        check_same("f", {"registration": 64 * "1"}, {"registration": 64 * "2"})  # digests tell a reader nothing
    older = {name: value for name, value in asked.items() if name != "registration"}
    (tmp_path / "avatar.json").write_text(json.dumps(older | {"steps": None}))
    assert begin(tmp_path, asked)
    with pytest.raises(UserError, match='run: holds "/old/run", asked is "/new/run"'):
        begin(tmp_path, asked | {"run": "/new/run"})


def test_finished_training_is_not_begun_again(tmp_path):
    begin(tmp_path, {"scene": "walk"})
    (tmp_path / "avatar.json").write_text(json.dumps({"scene": "walk", "steps": {"body": 3}}))
    assert not begin(tmp_path, {"scene": "walk"})


def test_of_two_lists_of_frames_the_message_names_what_only_one_has():
    held, asked = list(range(0, 320, 4)), list(range(0, 400, 4))
    with pytest.raises(UserError, match="f: frames: asked are frames 320, 324, .* too: take another folder"):
        check_same("f", {"frames": held}, {"frames": asked})
    with pytest.raises(UserError, match="holds frames 0, which are not asked for, asked are frames 320 too"):
        check_same("f", {"holdout": held}, {"holdout": [*held[1:], 320]})
    with pytest.raises(UserError, match=r"image: holds \[512, 512\], asked is \[256, 512\]"):
        check_same("f", {"image": [512, 512]}, {"image": [256, 512]})


def test_long_values_are_shortened():
    with pytest.raises(UserError) as error:
        check_same("f", {"frames": list(range(1000))}, {"frames": [1]})
    assert len(str(error.value)) < 200


@pytest.mark.parametrize(
    "text, message",
    [
        (None, "the file is missing: the folder holds no avatar"),
        ("{", "not JSON"),
        ("[1]", "holds a list, expected a dict"),
        ("{}", "has not finished"),
        ('{"steps": {}, "settings": {"lr": "fast"}}', "lr: Input should be a valid number"),
        ('{"steps": {}, "settings": {"speed": 1}}', "speed: Extra inputs are not permitted"),
        ('{"steps": {}}', "settings: expected a dict"),
        (
            '{"steps": {}, "settings": {}, "run": "", "frames": [], "holdout": []}',
            "architecture: expected a dict",
        ),
    ],
)
def test_bad_facts_are_refused(text, message, tmp_path):
    if text is not None:
        (tmp_path / "avatar.json").write_text(text)
    with pytest.raises(UserError, match=message):
        read_facts(tmp_path)
