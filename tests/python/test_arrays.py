"""Files of arrays: read as written, and refused where they are not whole."""

import json
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import files
import numpy as np
from dropj import _arrays


class Arrays(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = Path(folder.name) / "a.safetensors"

    def read(self, data):
        self.path.write_bytes(data)
        return _arrays.read(self.path)

    def refused(self, data):
        with self.assertRaises(ValueError) as met:
            self.read(data)
        self.assertIn(str(self.path), str(met.exception))
        return str(met.exception)

    def test_every_type_is_read_as_single_precision(self):
        values = np.array([[1.0, -2.0, 0.5], [2.0**-14, 6.0e-8, 65504.0]], np.float32)
        bits = (values[:, :2].copy().view(np.uint32) >> 16).astype(np.uint16)
        metadata, arrays = self.read(
            files.safetensors(
                {
                    "single": values,
                    "half": values.astype(np.float16),
                    "double": values.astype(np.float64),
                    "brain": ("BF16", bits),
                    "steps": np.array([3, 2**32 - 1], np.uint32),
                    "none": np.zeros((0, 3), np.float32),
                },
                {"seed": "7"},
            )
        )
        self.assertEqual(metadata, {"seed": "7"})
        np.testing.assert_array_equal(arrays["single"], values)
        np.testing.assert_array_equal(arrays["double"], values)
        np.testing.assert_array_equal(arrays["half"], values.astype(np.float16).astype(np.float32))
        np.testing.assert_allclose(arrays["brain"], values[:, :2], rtol=2**-7)
        self.assertEqual((arrays["brain"].dtype, arrays["steps"].tolist()), (np.float32, [3, 2**32 - 1]))
        self.assertEqual(arrays["none"].shape, (0, 3))

    def test_what_is_cut_or_damaged_is_refused(self):
        whole = files.safetensors({"a": np.ones((2, 2), np.float32), "b": np.ones(3, np.float32)}, {"x": "y"})
        for n in range(len(whole)):
            self.refused(whole[:n])
        self.assertIn("are there", self.refused(whole + b"\0"))
        # Any byte of the header: it is read or refused, and never anything else.
        for at in range(len(whole) - 28):
            for byte in (0, 34, 57, 255):
                try:
                    self.read(whole[:at] + bytes([byte]) + whole[at + 1 :])
                except ValueError:
                    pass

    def test_headers_that_lie_are_refused(self):
        def header(text):
            return struct.pack("<Q", len(text)) + text.encode()

        def told(**change):
            entry = {"dtype": "F32", "shape": [1], "data_offsets": [0, 4], **change}
            return header(json.dumps({"a": entry})) + b"\0" * 4

        self.assertEqual(self.read(told())[1]["a"].tolist(), [0.0])
        for change, why in [
            ({"shape": [2]}, "does not have 4 bytes"),
            ({"shape": [-1]}, "can be"),
            ({"shape": [True]}, "can be"),
            ({"shape": [1] * 9}, "can be"),
            ({"shape": [0, 2**62], "data_offsets": [0, 0]}, "are there"),
            ({"data_offsets": [4, 8]}, "does not begin"),
            ({"data_offsets": [4, 0]}, "does not have"),
            ({"dtype": "I64"}, "is of the type"),
        ]:
            self.assertIn(why, self.refused(told(**change)), change)
        self.assertIn("at most", self.refused(struct.pack("<Q", 2**63) + b"{}"))
        self.assertIn("twice", self.refused(header('{"a": 1, "a": 1}')))
        self.assertIn("more than texts", self.refused(header('{"__metadata__": {"a": 1}}')))
        self.assertIn("cannot be read", self.refused(header("[" * 100_000)))
        self.assertIn("no object", self.refused(header("[]")))
        self.assertIn("zip", self.refused(b"PK\x03\x04\0\0\0\0\0\0"))
        self.assertIn("git lfs pull", self.refused(b"version https://git-lfs.github.com/spec/v1\noid"))

    def test_numbers_that_are_none_are_refused_by_name(self):
        for value in (np.nan, np.inf):
            self.assertIn("'mean'", self.refused(files.safetensors({"mean": np.array([value], np.float32)})))

    def test_importing_the_package_imports_nothing_else(self):
        script = (
            "import sys, dropj; dir(dropj)\n"
            "assert not {'numpy', 'torch', 'gymnasium'} & set(sys.modules), sorted(sys.modules)\n"
            "from dropj import *\n"
            "assert 'numpy' not in sys.modules and dropj.serve is serve\n"
            "dropj.load_world\nassert 'numpy' in sys.modules and 'torch' not in sys.modules"
        )
        subprocess.run([sys.executable, "-c", script], check=True)
