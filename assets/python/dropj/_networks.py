"""Where networks are computed: by PyTorch where it is there, by NumPy where it is not, in the same few lines.

What is given as arrays comes back as arrays. What is given as tensors comes back as tensors on the same device, and gradients
pass through it.
"""

import numpy as np


def torch_or_none():
    """PyTorch, if it can be imported."""
    try:
        import torch
    except ImportError:
        return None
    return torch


class Network:
    """Tensors by name, and whoever computes with them."""

    def __init__(self, tensors, backend=None, device=None):
        """backend is "torch" or "numpy", and the first where PyTorch is there; device is one of PyTorch's."""
        if backend not in (None, "torch", "numpy"):
            raise ValueError(f'backend is {backend!r}, and must be "torch" or "numpy"')
        torch = None if backend == "numpy" else torch_or_none()
        if backend == "torch" and torch is None:
            raise ImportError("backend='torch' needs PyTorch, which cannot be imported")
        self.backend = "numpy" if torch is None else "torch"
        self.device = "cpu" if device is None else device
        self._tensors = tensors  # arrays
        self._on = {}  # the same as PyTorch's tensors, by device

    def _computing(self, *given):
        """Who computes with what is given: used as `with network._computing(x) as m`."""
        tensors = [value for value in given if type(value).__module__.split(".")[0] == "torch"]
        if tensors:
            return _Torch(self._tensors_on(tensors[0].device), tensors[0].device, False)
        if self.backend == "torch":
            return _Torch(self._tensors_on(self.device), self.device, True)
        return _NumPy(self._tensors)

    def _tensors_on(self, device):
        key = str(device)
        if key not in self._on:
            import torch

            self._on[key] = {name: torch.from_numpy(value).to(device) for name, value in self._tensors.items()}
        return self._on[key]


class _NumPy:
    """Pictures are [B, H, W, C], channels last, as everywhere in dropj."""

    def __init__(self, tensors):
        self.t = tensors

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def taken(self, value):
        return np.asarray(value, np.float32)

    def pixels(self, frames):
        """Bytes as intensities; floating numbers are intensities already."""
        frames = np.asarray(frames)
        return frames.astype(np.float32) / np.float32(255) if frames.dtype == np.uint8 else self.taken(frames)

    def out(self, value):
        return value

    def bytes(self, intensities):
        return np.clip(np.round(intensities * np.float32(255)), 0, 255).astype(np.uint8)

    def concatenate(self, parts):
        lead = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
        return np.concatenate([np.broadcast_to(part, lead + part.shape[-1:]) for part in parts], -1)

    def linear(self, x, weight, bias):
        return x @ weight.T + bias

    def members(self, x, weight, bias):
        """[E, N, in] by [E, out, in] and [E, out]."""
        return x @ weight.transpose(0, 2, 1) + bias[:, None]

    def relu(self, x):
        return np.maximum(x, 0)

    def leaky_relu(self, x):
        return np.where(x > 0, x, np.float32(0.01) * x)

    def sigmoid(self, x):
        return (np.tanh(x * np.float32(0.5)) + 1) * np.float32(0.5)

    def tanh(self, x):
        return np.tanh(x)

    def exp(self, x):
        return np.exp(x)

    def softmax(self, x):
        weights = np.exp(x - x.max(-1, keepdims=True))
        return weights / weights.sum(-1, keepdims=True)

    def log_softmax(self, x):
        x = x - x.max(-1, keepdims=True)
        return x - np.log(np.exp(x).sum(-1, keepdims=True))

    def cumulative(self, x):
        return np.cumsum(x, -1)

    def one_hot(self, index, n):
        return (index[..., None] == np.arange(n)).astype(np.float32)

    def clip(self, x, low, high):
        return np.clip(x, low, high)

    def stacked(self, rows, n):
        """The same rows for each of n members."""
        return np.broadcast_to(rows, (n,) + rows.shape)

    def conv(self, x, weight, bias, stride, padding):
        """weight is [out, in, k, k]."""
        x = np.pad(x, [(0, 0), (padding, padding), (padding, padding), (0, 0)])
        seen = np.lib.stride_tricks.sliding_window_view(x, weight.shape[2:], (1, 2))[:, ::stride, ::stride]
        return np.tensordot(seen, weight, ([3, 4, 5], [1, 2, 3])) + bias

    def deconv(self, x, weight, bias, stride, padding, more):
        """weight is [in, out, k, k]: every pixel stamps a patch of k by k, and overlapping ones add up.

        more: of the rows and columns that padding cuts off at the end, how many are kept.
        """
        b, rows, columns, _ = x.shape
        _, n_out, k, _ = weight.shape
        y = np.zeros((b, (rows - 1) * stride + k, (columns - 1) * stride + k, n_out), np.float32)
        for i in range(k):
            for j in range(k):
                stamp = x @ weight[:, :, i, j]
                y[:, i : i + (rows - 1) * stride + 1 : stride, j : j + (columns - 1) * stride + 1 : stride] += stamp
        last = [side - padding + kept for side, kept in zip(y.shape[1:3], more)]
        return y[:, padding : last[0], padding : last[1]] + bias


class _Torch:
    def __init__(self, tensors, device, as_arrays):
        import torch

        self.torch, self.t, self.device, self.as_arrays = torch, tensors, device, as_arrays

    def __enter__(self):
        self.gradients = self.torch.set_grad_enabled(self.torch.is_grad_enabled() and not self.as_arrays)
        self.gradients.__enter__()
        return self

    def __exit__(self, *met):
        self.gradients.__exit__(*met)

    def taken(self, value):
        if isinstance(value, self.torch.Tensor):
            return value.to(self.device, self.torch.float32)
        return self.torch.from_numpy(np.array(value, np.float32)).to(self.device)

    def pixels(self, frames):
        if not isinstance(frames, self.torch.Tensor):
            frames = np.asarray(frames)
            frames = self.torch.from_numpy(np.ascontiguousarray(frames)).to(self.device)
        return frames.to(self.torch.float32) / 255 if frames.dtype == self.torch.uint8 else self.taken(frames)

    def out(self, value):
        return value.cpu().numpy() if self.as_arrays else value

    def bytes(self, intensities):
        return (intensities * 255).round().clamp(0, 255).to(self.torch.uint8)

    def concatenate(self, parts):
        lead = self.torch.broadcast_shapes(*(part.shape[:-1] for part in parts))
        return self.torch.cat([part.expand(lead + part.shape[-1:]) for part in parts], -1)

    def linear(self, x, weight, bias):
        return self.torch.nn.functional.linear(x, weight, bias)

    def members(self, x, weight, bias):
        return self.torch.baddbmm(bias.unsqueeze(1), x, weight.transpose(1, 2))

    def relu(self, x):
        return x.relu()

    def leaky_relu(self, x):
        return self.torch.nn.functional.leaky_relu(x, 0.01)

    def sigmoid(self, x):
        return x.sigmoid()

    def tanh(self, x):
        return x.tanh()

    def exp(self, x):
        return x.exp()

    def softmax(self, x):
        return x.softmax(-1)

    def log_softmax(self, x):
        return x.log_softmax(-1)

    def cumulative(self, x):
        return x.cumsum(-1)

    def one_hot(self, index, n):
        return (index.unsqueeze(-1) == self.torch.arange(n, device=index.device)).to(self.torch.float32)

    def clip(self, x, low, high):
        return x.clamp(low, high)

    def stacked(self, rows, n):
        return rows.expand((n,) + tuple(rows.shape))

    def conv(self, x, weight, bias, stride, padding):
        y = self.torch.nn.functional.conv2d(x.permute(0, 3, 1, 2), weight, bias, stride, padding)
        return y.permute(0, 2, 3, 1)

    def deconv(self, x, weight, bias, stride, padding, more):
        y = self.torch.nn.functional.conv_transpose2d(x.permute(0, 3, 1, 2), weight, bias, stride, padding, more)
        return y.permute(0, 2, 3, 1)
