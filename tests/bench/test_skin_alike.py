"""What a lead would be were the single layer's bare skin as good as the layers'."""

import json

import pytest

from bench.skin_alike import leads, main


def measured(mse, body_mse):
    return {"mse": mse, "body_mse": body_mse, "pixels": 1000, "body_pixels": 100}


def test_the_error_that_skin_has_too_much_is_taken_off_the_whole():
    """A tenth of the pixels errs by 20 too much: 2 of the single layer's 100."""
    assert leads(measured(70.0, 40.0), measured(100.0, 60.0)) == pytest.approx((-0.3, -1 / 3, 70 / 98 - 1))


def test_skin_that_errs_less_than_the_layers_stays_as_it_is():
    assert leads(measured(70.0, 60.0), measured(100.0, 40.0)) == pytest.approx((-0.3, 0.5, -0.3))


def test_each_pair_on_record_has_its_row(tmp_path, capsys):
    pair = {"all": {"layered": measured(70.0, 40.0), "baseline": measured(100.0, 60.0)}}
    alone = {"all": {"layered": measured(70.0, 40.0), "baseline": None}}
    path = tmp_path / "records.json"
    path.write_text(
        json.dumps({"a": {"driven": pair, "driven by codes": pair, "reconstruction": alone}, "b": {"driven": pair}})
    )
    main(path, "a")
    assert capsys.readouterr().out.splitlines()[2:] == ["| a | driven | -30.0 % | -33.3 % | -28.6 % |"]
