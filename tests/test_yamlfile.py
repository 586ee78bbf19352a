"""YAML that would overflow libyaml's stack is rejected before parsing."""

import pytest
import yaml

from gcd_dataset.yamlfile import require_shallow, strict_yaml


@pytest.mark.parametrize("content", [b"[" * 100_000, b"{a: " * 50_000, b"- " * 50_000, b"? " * 50_000], ids=repr)
def test_deep_nesting_is_refused(content: bytes) -> None:
    with pytest.raises(RecursionError, match="levels deep"):
        require_shallow(content)


def test_a_repeated_key_is_named_among_many() -> None:
    keys = "".join(f"k{number}: 0\n" for number in range(5_000))
    with pytest.raises(yaml.MarkedYAMLError, match="a repeated key: remove one of the entries") as caught:
        strict_yaml(f"{keys}z: 0\nz: 1\n")
    assert caught.value.problem_mark is not None and caught.value.problem_mark.line == 5_000


def test_a_byte_order_mark_is_skipped() -> None:
    assert strict_yaml(b"\xef\xbb\xbfa: 1") == {"a": 1}


def test_a_page_of_lists_is_read() -> None:
    page = yaml.safe_dump({"labels": {name: list(range(3000)) for name in "abc"}, "ranges": [[1, [2]]] * 2000})
    require_shallow(page.encode())
    assert strict_yaml(page)["labels"]["b"][-1] == 2999
