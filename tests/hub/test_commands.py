"""``gcd publish``, ``download``, ``info`` and ``show`` of data sets on servers."""

from pathlib import Path

import pytest

from gcd_dataset.cli import main
from gcd_dataset.loaders import GarmentDataset
from gcd_dataset.loaders.fake import fake_sample
from gcd_dataset.shards import ShardWriter
from tests.hub.server import Hub, read_folder

# A deprecation within ``huggingface_hub``.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    with ShardWriter(tmp_path / "data", seed=0, recipe={"stage": "drape"}, shard_size=4) as writer:
        for number in range(10):
            writer.write(fake_sample(0, number))
    return tmp_path / "data"


def test_publish_and_download(
    hub: Hub, data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_TOKEN", hub.token)
    monkeypatch.chdir(tmp_path)
    before, here = read_folder(data), ["--endpoint", hub.endpoint]
    assert main(["publish", str(data), "me/garments", "--dry-run", *here]) == 0
    assert "would be uploaded to me/garments; nothing was sent" in capsys.readouterr().out
    assert not hub.log
    assert main(["publish", str(data), "me/garments", *here]) == 0
    commit = hub.repos["me/garments"].commits[-1][0]
    assert f"me/garments@{commit}" in capsys.readouterr().out
    assert {name: data for name, data in read_folder(data).items() if not name.startswith("published/")} == before

    assert main(["download", "me/garments", "--quiet", *here]) == 0
    assert f"train of hf://datasets/me/garments@{commit}: " in capsys.readouterr().out
    whole = [GarmentDataset("garments", path.name.removesuffix(".index")) for path in Path("garments").glob("*.index")]
    assert sum(map(len, whole)) == 10 and "front" in whole[0].fields
    assert main(["check", "garments", "--bytes"]) == 0
    some = ["download", "me/garments", "--split", "train", "--no-views", "--quiet", "--out", "some", *here]
    assert main(some) == 0
    assert main(["check", "some", "--bytes"]) == 0
    assert not {"front", "back"} & set(GarmentDataset("some").fields)
    capsys.readouterr()
    assert main(["info", "me/garments", *here]) == 0
    assert f"hf://datasets/me/garments@{commit}" in capsys.readouterr().out


def test_splits_that_share_designs_are_a_fault(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with ShardWriter(data, split="test", seed=0, recipe={"stage": "drape"}, shard_size=4) as writer:
        writer.write(fake_sample(0, 3))
    assert main(["check", str(data)]) == 1
    assert f"{data}: test and train share 1 design: scores on one are biased" in capsys.readouterr().out


def test_show_draws_a_sample_of_a_repository(hub: Hub, data: Path, tmp_path: Path) -> None:
    hub.publish("me/garments", data)
    pictures = [tmp_path / "here.png", tmp_path / "there.png"]
    for what, png in zip([str(data), "me/garments"], pictures, strict=True):
        assert main(["show", what, "--index", "3", "--png", str(png), "--endpoint", hub.endpoint]) == 0
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
