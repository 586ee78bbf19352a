"""The patterns of a recipe, made without draping, and their hashes. For a new recipe run

    python -m gcd_dataset.generator.recipes.hashing standard-1k --workers 2

and write the printed lines into it. A core makes 15 patterns a second; the line of the first ten comes at once.
"""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice

from gcd_dataset.generator.pipeline import DrapedDesign, DressedDesign, prepare
from gcd_dataset.generator.recipes import Recipe, find_recipe
from gcd_dataset.patternhash import PatternHash
from gcd_dataset.tensors import PatternTensor, encode_pattern
from gcd_dataset.workers import parallel_map

PART = 100  # designs that a process hashes at a time


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


def hash_of(recipe: Recipe, designs: range) -> PatternHash:
    """The hash of the patterns of the given designs."""
    return PatternHash.of(made_patterns(recipe, designs))


def main() -> None:
    """Print the hashes of the first ten and of all patterns of a recipe."""
    parser = argparse.ArgumentParser(description="the hashes of the first ten and of all patterns of a recipe")
    parser.add_argument("recipe", help="name of a recipe, or path of a TOML file")
    parser.add_argument("--designs", type=int, help="hash the patterns of the first designs alone")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args()
    recipe = find_recipe(options.recipe)
    designs = range(recipe.designs)[: options.designs]
    first = PatternHash.of(islice(made_patterns(recipe, designs), 10))
    print(f'first_ten = "{first.text}"', flush=True)
    parts, found = (designs[k : k + PART] for k in designs[::PART]), PatternHash()
    for part in parallel_map(partial(hash_of, recipe), parts, options.workers):
        found += part
    print(f'{"patterns" if options.designs is None else f"# of {len(designs)} designs"} = "{found.text}"')


if __name__ == "__main__":
    main()
