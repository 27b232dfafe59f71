"""Of each pair of avatars on record: its lead, and what this would be if the single layer's bare skin erred no more than the layers'.

python -m bench.skin_alike docs/measurements/avatars.json [WORDS THAT A RECORD'S NAME BEGINS WITH]
"""

import json
import sys

COMPARED = ("driven", "reconstruction")


def leads(layers, single):
    """Changes of `mse` and of `body_mse`, and of `mse` with the single layer's `body_mse` as low as the layers', where it is higher."""
    skin = single["body_pixels"] / single["pixels"] * max(single["body_mse"] - layers["body_mse"], 0.0)
    body = layers["body_mse"] / single["body_mse"] - 1
    return layers["mse"] / single["mse"] - 1, body, layers["mse"] / (single["mse"] - skin) - 1


def main(path, beginning=""):
    with open(path) as file:
        records = json.load(file)
    print("| record | | `mse` | `body_mse` | `mse`, bare skin alike |\n|---|---|---|---|---|")
    for name, record in records.items():
        for row, one in record.items():
            if name.startswith(beginning) and row.split(",")[0] in COMPARED and one["all"].get("baseline"):
                changes = leads(one["all"]["layered"], one["all"]["baseline"])
                print(f"| {name} | {row} | " + " | ".join(f"{100 * change:+.1f} %" for change in changes) + " |")


if __name__ == "__main__":
    main(*sys.argv[1:])
