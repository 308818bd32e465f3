"""The key and the record of a step, and what a product says of its origin."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import ValidationError

from shared.artifacts.manifest import FileEntry, InputEntry, Manifest, Product, combine, step_key

PARTS: dict[str, Any] = {
    "process": "predict-access",
    "code_version": "0.1.0+abc",
    "model_version": "m1",
    "inputs": {"targets": "0" * 64, "stations": "1" * 64},
    "parameters": {"radius_km": 10.0, "area": None, "names": ["a", "b"]},
}
MANIFEST = Manifest(
    case="tiny",
    cycle="c1",
    key="k" * 24,
    product=Product(process="p", code_version="v", simulated=True, simulated_share=0.5, oldest_input="2024-01-01"),
    inputs=(InputEntry(name="targets", href="tiny/c0/p/k/t.parquet", sha256="0" * 64),),
    parameters={"area": None, "nested": {"left_out": None}},
    outputs={"points": None, "count": 2},
    files={
        "a.nc": FileEntry(sha256="1" * 64, size=1, type="application/x-netcdf"),
        "b.nc": FileEntry(
            sha256="2" * 64, size=1, type="application/x-netcdf", simulated=False, simulated_share=0.0, oldest_input=""
        ),
    },
)


@pytest.mark.parametrize(
    "change",
    [
        {"process": "check-plan"},
        {"code_version": "0.1.0+abd"},
        {"model_version": ""},
        {"inputs": {"targets": "0" * 64, "stations": "2" * 64}},
        {"inputs": {"targets": "1" * 64, "stations": "0" * 64}},
        {"inputs": {"targets": "0" * 64}},
        {"parameters": {**PARTS["parameters"], "radius_km": 10.000001}},
        {"parameters": {**PARTS["parameters"], "area": []}},
        {"parameters": {**PARTS["parameters"], "names": ["b", "a"]}},
    ],
)
def test_the_key_changes_with_each_part(change: dict[str, Any]) -> None:
    assert step_key(**{**PARTS, **change}) != step_key(**PARTS)


def test_texts_do_not_run_into_each_other() -> None:
    assert step_key("a", "bc", "", {}, {}) != step_key("ab", "c", "", {}, {})


def test_the_key_does_not_depend_on_the_order_of_names() -> None:
    turned = {name: dict(reversed(PARTS[name].items())) for name in ("inputs", "parameters")}
    assert step_key(**{**PARTS, **turned}) == step_key(**PARTS)


def test_the_key_is_a_name_that_a_folder_can_have() -> None:
    key = step_key(**PARTS)
    assert len(key) == 24
    assert set(key) <= set("0123456789abcdef")


def product(share: float, oldest: str = "") -> Product:
    return Product(process="p", code_version="v", simulated=share > 0, simulated_share=share, oldest_input=oldest)


def test_what_is_combined_has_the_mean_share_and_the_oldest_age() -> None:
    found = combine(
        "q", "v2", "m", [product(1.0, "2024-07-02T00:00:00Z"), product(0.0), product(0.5, "2023-01-01T00:00:00Z")]
    )
    assert found == Product(
        process="q",
        code_version="v2",
        model_version="m",
        simulated=True,
        simulated_share=0.5,
        oldest_input="2023-01-01T00:00:00Z",
    )


def test_what_is_combined_from_real_things_is_real() -> None:
    found = combine("q", "v", "", iter([product(0.0), product(0.0)]))
    assert (found.simulated, found.simulated_share, found.oldest_input) == (False, 0.0, "")


def test_what_has_no_inputs_is_real_and_ageless() -> None:
    assert combine("q", "v", "", []) == Product(process="q", code_version="v")


def test_a_little_simulation_is_still_simulation() -> None:
    assert combine("q", "v", "", [product(1e-9), *[product(0.0)] * 9]).simulated


def test_the_manifest_round_trips_with_its_nulls() -> None:
    assert Manifest.model_validate_json(MANIFEST.to_bytes()) == MANIFEST
    assert json.loads(MANIFEST.to_bytes())["outputs"] == {"points": None, "count": 2}


def test_the_manifest_is_canonical() -> None:
    turned = MANIFEST.model_copy(
        update={name: dict(reversed(getattr(MANIFEST, name).items())) for name in ("outputs", "parameters", "files")}
    )
    assert turned.to_bytes() == MANIFEST.to_bytes()
    assert "source" not in MANIFEST.to_bytes().decode(), "what is not stated is left out"


def test_a_file_may_differ_from_its_step() -> None:
    assert MANIFEST.product_of("a.nc") == MANIFEST.product
    own = MANIFEST.product_of("b.nc")
    assert (own.simulated, own.simulated_share, own.oldest_input) == (False, 0.0, "")
    assert own.process == "p"


def test_an_unknown_field_is_refused() -> None:
    document = {**json.loads(MANIFEST.to_bytes()), "made_at": "now"}
    with pytest.raises(ValidationError, match="made_at"):
        Manifest.model_validate(document)
