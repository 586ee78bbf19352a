"""The patterns of a recipe, made without draping, and their hashes. For a new recipe run

    python -m gcd_dataset.generator.recipes.hashing standard-1k

and write the printed lines into it. A core makes 15 patterns a second; the line of the first ten comes at once.
"""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice

from gcd_dataset.generator.pipeline import DrapedDesign, DressedDesign, prepare
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.tensors import PatternTensor, encode_pattern


def made_patterns(recipe: Recipe, designs: Iterable[int]) -> Iterator[tuple[int, *tuple[PatternTensor, ...]]]:
    """Index and pattern, or patterns of the outfit, of all samples of the given designs.

    Raises ``PatternError`` as ``produce`` does.
    """
    # Up to the mesh: a design that cannot be meshed is rejected, and the next attempt has another pattern.
    config = recipe.config
    if config.stage == "drape":
        config = replace(config, stage="mesh", maps=False, poses="", views=0)
    for number in designs:
        worn = list[DressedDesign]()
        while not worn or not worn[-1].is_outermost:
            under = tuple(DrapedDesign(inner, ()) for inner in worn)
            worn.append(prepare(recipe.seed, number, config, under=under))
        for wearers in zip(*(design.dressed for design in worn), strict=True):
            yield wearers[0].index, *(encode_pattern(wearer.pattern) for wearer in wearers)


def main() -> None:
    """Print the hashes of the first ten and of all patterns of a recipe."""
    parser = argparse.ArgumentParser(description="the hashes of the first ten and of all patterns of a recipe")
    parser.add_argument("recipe", help="name of a recipe, or path of a TOML file")
    recipe = find_recipe(parser.parse_args().recipe)
    made = made_patterns(recipe, range(recipe.designs))
    first = PatternHash.of(islice(made, 10))
    print(f'first_ten = "{first.text}"', flush=True)
    print(f'patterns = "{(first + PatternHash.of(made)).text}"')


if __name__ == "__main__":
    main()
