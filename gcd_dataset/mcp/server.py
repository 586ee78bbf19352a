"""The server of ``gcd-mcp``: runs the tools for a client that speaks the Model Context Protocol over stdio.

A call runs in a process of its own, one at a time, and is ended with its client or after a time limit.
"""

import asyncio
import functools
import json
import sys
from collections.abc import Callable, Coroutine, Sequence
from pathlib import Path
from typing import Any

from gcd_dataset import __version__
from gcd_dataset.cli.common import Parser
from gcd_dataset.mcp.tools import TOOLS, Answer, Tools

SECONDS = 300.0
INSTRUCTIONS = (
    "Sewing patterns of garments, drawn to measure for bodies and draped on them. All paths are relative to one "
    "folder; nothing is overwritten unless overwrite is true. Units are centimetres and degrees."
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve until the client closes stdin. Exits 2 for a missing folder or library."""
    parser = Parser(prog="gcd-mcp", description="Tools of gcd for agents, over MCP on stdio.")
    parser.add_argument("root", type=Path, metavar="ROOT", help="the folder that tools read from and write to")
    parser.add_argument(
        "--seconds", type=float, default=SECONDS, help=f"time limit of a call (default: {SECONDS:g})", metavar="S"
    )
    options = parser.parse_args(arguments)
    if not options.root.is_dir():
        parser.error(f"{options.root}: no such folder: create it")
    try:
        from mcp.server import MCPServer
    except ImportError as error:
        parser.error(f"mcp is not installed ({error}): run pip install 'gcd-dataset[mcp]'")
    server = MCPServer("gcd", version=__version__, instructions=INSTRUCTIONS, log_level="WARNING")
    tools, turn = Tools(options.root.resolve()), asyncio.Lock()
    for name in TOOLS:
        server.add_tool(_limited(getattr(tools, name), tools.root, options.seconds, turn), structured_output=False)
    server.run()


def _limited(
    tool: Callable[..., Answer], root: Path, seconds: float, turn: asyncio.Lock
) -> Callable[..., Coroutine[Any, Any, Any]]:
    """The tool with its signature and docstring, run in a process that lasts ``seconds`` at most."""
    from mcp.types import CallToolResult, ImageContent, TextContent

    @functools.wraps(tool)
    async def call(**given: Any) -> Any:
        async with turn:
            answer = await _answer(tool.__name__, given, root, seconds)
        content: list[Any] = [TextContent(type="text", text=answer["text"])]
        if answer["picture"]:
            content.append(ImageContent(type="image", data=answer["picture"], mime_type="image/png"))
        return CallToolResult(content=content, is_error=answer["refused"])

    return call


async def _answer(name: str, given: dict[str, Any], root: Path, seconds: float) -> dict[str, Any]:
    """What ``tools.main`` prints, or a refusal of a call that takes too long or dies."""
    # -P: Python would import modules from the current folder, which an agent may write to.
    command = (sys.executable, "-P", "-m", "gcd_dataset.mcp.tools", str(root), name)
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe)
    printed, fault = b"", ""
    try:
        async with asyncio.timeout(seconds):
            printed, _ = await process.communicate(json.dumps(given).encode())
    except TimeoutError:
        fault = f"{name}: ended after {seconds:g} s: give fewer garments, a coarser resolution, or more --seconds"
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if not fault and process.returncode:
        fault = f"{name}: died with exit code {process.returncode}: its last lines are in the log of gcd-mcp"
    answer: dict[str, Any] = {"text": fault, "picture": None, "refused": True} if fault else json.loads(printed)
    return answer
