"""The examples of the package's page run."""

import contextlib
import importlib.util
import io
import os
import re
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class Readme(unittest.TestCase):
    def test_the_examples_run(self):
        page = (ROOT / "assets/python/dropj/README.md").read_text(encoding="utf-8")
        section = page.split("## From dropj to Python")[1].split("\n## ")[0]
        examples = re.findall(r"```python\n(.*?)```", section, re.S)
        self.assertGreater(len(examples), 5)
        before = os.getcwd()
        os.chdir(ROOT)
        self.addCleanup(os.chdir, before)
        n_run = 0
        for example in examples:
            imported = re.findall(r"^(?:import|from) (\w+)", example, re.M)
            if "dropj" not in imported or not all(importlib.util.find_spec(name) for name in imported):
                continue
            with self.subTest(example=example), contextlib.redirect_stdout(io.StringIO()):
                exec(compile(example, "README.md", "exec"), {})
            n_run += 1
        self.assertGreaterEqual(n_run, 3)
