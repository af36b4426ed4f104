"""Machine code in a wheel, compiled while it is built if DRAKE_AIGTO_MACHINE_CODE asks for it.

    DRAKE_AIGTO_MACHINE_CODE=all python -m build --wheel --no-isolation

That of all shipped scenarios, or of those that are named in place of "all". The wheel has a
platform's tag, and needs the Numba that compiled it. Without isolation, as what compiles is the
package itself, with all that it depends on.
"""

import importlib.metadata
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class MachineCodeHook(BuildHookInterface):
    """Hatchling's hook for wheels."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compiles, and adds the folder to the wheel."""
        asked = os.environ.get("DRAKE_AIGTO_MACHINE_CODE", "").split()
        if version == "editable" or not asked:
            return
        root, folder = Path(self.root), Path(self.root) / "build" / "machine_code"
        shutil.rmtree(folder, ignore_errors=True)
        compiler = root / ".ci" / "compile_kernels.py"
        names = [] if asked == ["all"] else asked
        subprocess.run([sys.executable, str(compiler), str(folder), *names], check=True, cwd=root)
        build_data["force_include"][str(folder)] = "drake_aigto/machine_code"
        build_data["pure_python"], build_data["infer_tag"] = False, True
        build_data["dependencies"].append(f"numba=={importlib.metadata.version('numba')}")
