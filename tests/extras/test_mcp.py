"""``gcd-mcp`` over stdio, called by the client of the official SDK."""

import asyncio
import base64
import io
import json
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from gcd_dataset.mcp.tools import TOOLS
from tests.extras.guide import ROOT, blocks_of

mcp = pytest.importorskip("mcp", reason="mcp is not installed: make test-extras")
stdio = pytest.importorskip("mcp.client.stdio")

SKIRT = {"meta": {"bottom": "SkirtCircle"}}


def serve(root: Path, work: Callable[[Any], Awaitable[Any]], *options: str) -> Any:
    """What ``work`` returns for a client of a server of ``root``."""
    words = ["-c", "from gcd_dataset.mcp.server import main; main()", str(root), *options]
    env = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}

    async def connected() -> Any:
        async with mcp.Client(stdio.StdioServerParameters(command=sys.executable, args=words, env=env)) as client:
            return await work(client)

    return asyncio.run(connected())


async def answer(client: Any, tool: str, **given: Any) -> tuple[str, Image.Image]:
    """Text and picture of a call that succeeds."""
    result = await client.call_tool(tool, given)
    text, picture = result.content
    assert not result.is_error, text.text
    assert picture.mime_type == "image/png"
    return text.text, Image.open(io.BytesIO(base64.b64decode(picture.data)))


async def refusal(client: Any, tool: str, **given: Any) -> str:
    """Text of a call that is refused."""
    result = await client.call_tool(tool, given)
    [text] = result.content
    assert result.is_error
    return str(text.text)


def calls(root: Path) -> list[str]:
    """The processes that work for a server of ``root``."""
    listed = subprocess.run(["ps", "-ewwo", "args"], capture_output=True, text=True, check=True).stdout.splitlines()
    return [line for line in listed if f"gcd_dataset.mcp.tools {root}" in line]


def test_an_agent_draws_drapes_scores_and_exports(tmp_path: Path) -> None:
    async def work(client: Any) -> None:
        tools = (await client.list_tools()).tools
        assert [tool.name for tool in tools] == list(TOOLS)
        assert all(tool.description for tool in tools)
        assert tools[1].input_schema["required"] == ["out"]
        assert "pants.rise: a number from 0.5 to 1" in (await answer(client, "parameters", bottom="Pants"))[0]
        await answer(client, "draw", out="skirt", design=SKIRT)
        spec = "skirt/skirt_specification.json"
        assert (await answer(client, "check", spec=spec))[0] == "1 pattern: no fault found"
        text, picture = await answer(client, "drape", specs=[spec], out="draped", resolution=4, body="female:7")
        assert "skirt: SETTLED" in text
        assert str(tmp_path) not in text
        left, right = (picture.crop(box) for box in ((0, 0, 512, 540), (518, 0, 1030, 540)))
        assert all(len(side.getcolors(1 << 20) or ()) > 100 for side in (left, right))  # shaded: no blank sides
        assert (tmp_path / "draped" / "skirt.glb").read_bytes().startswith(b"glTF")
        assert "height: 156.6" in (await answer(client, "measure", body="female:7"))[0]
        assert "score.iou 1 share" in (await answer(client, "score", answer=spec, truth=spec))[0]
        for name in ("skirt.pdf", "skirt.dxf", "skirt.svg"):
            assert (await answer(client, "export", spec=spec, out=name))[0] == name
            assert (tmp_path / name).stat().st_size > 1000

    serve(tmp_path, work)


def test_refusals_are_the_sentences_of_gcd(tmp_path: Path) -> None:
    async def work(client: Any) -> None:
        assert await refusal(client, "check", spec="no.json") == (
            "no.json: no such file: give the path of a specification JSON"
        )
        assert "leads out of the root folder" in await refusal(client, "draw", out="../skirt", design=SKIRT)
        assert "not one of SkirtCircle" in await refusal(client, "parameters", bottom="Kilt")
        assert "Input should be a valid integer" in await refusal(client, "draw", out="skirt", seed="first")

    serve(tmp_path, work)
    assert list(tmp_path.iterdir()) == []


def test_a_call_ends_after_its_time_or_with_its_client(tmp_path: Path) -> None:
    async def too_long(client: Any) -> str:
        return await refusal(client, "draw", out="skirt", design=SKIRT)

    assert serve(tmp_path, too_long, "--seconds", "0.3").startswith("draw: ended after 0.3 s: give fewer garments")
    assert calls(tmp_path) == []

    async def leaves(client: Any) -> None:
        task = asyncio.create_task(client.call_tool("drape", {"specs": ["no.json"], "out": "draped"}))
        async with asyncio.timeout(60):
            while not calls(tmp_path):
                await asyncio.sleep(0.05)
        task.cancel()

    serve(tmp_path, leaves)
    assert calls(tmp_path) == []


def test_the_guide_configures_the_installed_command() -> None:
    [block] = [block for block in blocks_of(ROOT / "docs" / "guides" / "agents.md") if block.language == "json"]
    entry = json.loads(block.text)["mcpServers"]["gcd"]
    assert Path(entry["command"]).name == "gcd-mcp"
    assert len(entry["args"]) == 1
