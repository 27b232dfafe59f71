"""The study's sums and its table, of evaluations made up for the purpose."""

import json

import pytest

from bench.avatar import evaluations, goals, summary, table, write

MEASURES = ("mse", "band_mse", "body_mse", "garment_mse", "ssim", "band_ssim", "psnr")


def put(out, capture, seed, mse, band, body):
    """An evaluation whose layered avatar differs from the baseline (100) by these factors."""
    baseline = dict.fromkeys(MEASURES, 100.0)
    layered = baseline | {"mse": 100.0 * mse, "band_mse": 100.0 * band, "body_mse": 100.0 * body}
    folder = out / capture / f"seed{seed}"
    folder.mkdir(parents=True)
    (folder / "evaluation.json").write_text(json.dumps({"all": {"layered": layered, "baseline": baseline}}))


def test_goals_hold_only_when_every_seed_meets_them(tmp_path):
    for seed, band in enumerate((0.7, 0.75, 0.79)):
        put(tmp_path, "fitted", seed, 0.9, band, 1.0)
        put(tmp_path, "loose", seed, 0.9, band + 0.02, 0.94)
    found = summary(tmp_path)
    assert found["fitted"]["goals"] == {"foreground no worse": True, "band 20 % lower": True, "body within 5 %": True}
    assert found["loose"]["goals"] == {"foreground no worse": True, "band 20 % lower": False, "body within 5 %": False}
    assert found["fitted"]["band_mse"]["change"] == pytest.approx(-0.2533, abs=1e-4)
    assert (found["fitted"]["band_mse"]["best"], found["fitted"]["band_mse"]["worst"]) == pytest.approx((-0.3, -0.21))


def test_a_baseline_that_is_better_on_the_body_is_no_straw_man():
    row = {name: {"best": change, "worst": change} for name, change in (("mse", -0.1), ("band_mse", -0.3), ("body_mse", 0.2))}
    assert goals(row)["body within 5 %"]


def test_the_table_has_a_row_an_evaluation_and_survives_missing_measures(tmp_path):
    put(tmp_path, "fitted", 0, 0.9, 0.7, 1.0)
    put(tmp_path, "bare", 0, 0.9, 0.7, 1.0)
    path = tmp_path / "bare" / "seed0" / "evaluation.json"
    result = json.loads(path.read_text())
    for name in ("layered", "baseline"):
        result["all"][name] |= {"band_mse": None, "garment_mse": None}
    path.write_text(json.dumps(result))
    assert list(evaluations(tmp_path)) == [("bare", 0), ("fitted", 0)]
    text = table(tmp_path)
    assert "| fitted | 0 | 90.0 | 100.0 | -10.0 % | 70.0 | 100.0 | -30.0 % |" in text and "band 20 %" in text
    assert "| bare | 0 | 90.0 | 100.0 | -10.0 % | - | - | - |" in text
    write(tmp_path, {"seeds": [0]})
    assert json.loads((tmp_path / "study.json").read_text())["captures"].keys() == {"bare", "fitted"}
