"""MkDocs hooks: math fences become MathML, and all scripts are served from the site itself.

The built pages request nothing from the network.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pymdownx.superfences import fence_code_format

SCRIPTS = {  # on the site -> where `make site` unpacks it
    "assets/mermaid.min.js": ".venv/mermaid/package/dist/mermaid.min.js",  # diagrams
    "assets/iframe-worker.js": ".venv/iframe-worker/package/shim/index.js",  # search in pages opened as files
}
SHIM = "https://unpkg.com/iframe-worker/shim"  # the offline plugin's template names it


def on_config(config: Any) -> Any:
    """Add the fences `math` and `mermaid` to the code blocks that Markdown knows."""
    fences = config["mdx_configs"].setdefault("pymdownx.superfences", {}).setdefault("custom_fences", [])
    fences += [
        {"name": "math", "class": "math", "format": _mathml},
        {"name": "mermaid", "class": "mermaid", "format": fence_code_format},
    ]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the scripts. Raises PluginError where `make site` has not fetched one."""
    for path, source in SCRIPTS.items():
        script = Path(config["config_file_path"]).parent / source
        if not script.exists():
            raise PluginError(f"{script} is missing; build the site with `make site`")
        files.append(File.generated(config, path, abs_src_path=str(script)))
    return files


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Name the local script in place of the remote one."""
    return output.replace(SHIM, "../" * page.url.count("/") + "assets/iframe-worker.js")


def on_post_template(output_content: str, **_: Any) -> str:
    """The same in pages that are no documents (404.html)."""
    return output_content.replace(SHIM, "assets/iframe-worker.js")


def _mathml(source: str, *_: Any, **__: Any) -> str:
    """A display equation as MathML."""
    return f'<div class="equation">{convert(source.strip(), display="block")}</div>'
