"""Frames into a file that appears whole or not at all: mp4 where the extra `[video]` is installed,
else gif.
"""

import importlib
import importlib.util
import os
import tempfile
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from adaptsim_jax.core.files import output_errors


def best_suffix() -> str:
    """`.mp4` where it can be written here, else `.gif`."""
    if importlib.util.find_spec("imageio_ffmpeg"):
        return ".mp4"
    return ".gif"


def write_video(frames: Iterable[np.ndarray], path: Path, fps: float) -> Path:
    """Write `frames`, each `[H, W, 3]` uint8 with even H and W, to `path` (.mp4 or .gif)."""
    writer = {".mp4": _mp4, ".gif": _gif}[path.suffix]
    with output_errors(path):
        handle, temporary = tempfile.mkstemp(
            prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        try:
            writer(frames, temporary, fps)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    return path


def _mp4(frames: Iterable[np.ndarray], path: str, fps: float) -> None:
    ffmpeg: Any = importlib.import_module("imageio_ffmpeg")
    writer = None
    try:
        for frame in frames:
            if writer is None:
                size = frame.shape[1::-1]
                writer = ffmpeg.write_frames(
                    path, size, fps=fps, quality=8, macro_block_size=2, ffmpeg_log_level="error"
                )
                with (
                    warnings.catch_warnings()
                ):  # JAX warns of the fork, whose child is the encoder at once
                    warnings.filterwarnings(
                        "ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning
                    )
                    writer.send(None)
            writer.send(np.ascontiguousarray(frame))
    finally:
        if writer is not None:
            writer.close()


def _gif(frames: Iterable[np.ndarray], path: str, fps: float) -> None:
    from PIL import Image

    # One palette for all, or still parts flicker; of the widest cover, or small marks lose their
    # colour; no dithering, which would crawl. It is taken from a few pictures at once.
    images = [Image.fromarray(frame) for frame in frames]
    few = np.concatenate([np.asarray(image) for image in images[:: max(len(images) // 4, 1)]])
    palette = Image.fromarray(few).quantize(
        256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    flat = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    flat[0].save(
        path,
        save_all=True,
        append_images=flat[1:],
        duration=round(1000 / fps),
        loop=0,
        optimize=False,
    )
