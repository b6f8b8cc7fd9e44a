"""Many small pictures on one sheet, with captions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from facewright.errors import ShapeError


def contact_sheet(
    images: Sequence[NDArray[np.uint8]],
    captions: Sequence[str] | None = None,
    *,
    columns: int = 5,
    gap: int = 6,
    caption_height: int = 22,
    background: tuple[int, int, int] = (255, 255, 255),
) -> NDArray[np.uint8]:
    """Lay pictures of one size out in rows.

    Parameters
    ----------
    images : sequence of ndarray of shape (H, W, 3), uint8
        Pictures, in reading order; all of one size.
    captions : sequence of str, optional
        One line under each picture.
    columns : int
        Pictures per row.
    gap, caption_height : int, pixels
        Space between pictures and for a caption.
    background : sRGB colour
        Colour of the sheet.

    Returns
    -------
    ndarray of shape (H', W', 3), uint8
        The sheet.

    Raises
    ------
    ShapeError
        If there are no pictures, sizes differ, or captions are of another number.
    """
    if not images or any(image.shape != images[0].shape for image in images):
        raise ShapeError(f"images must be one or more of one size, got {sorted({i.shape for i in images})}.")
    if captions is not None and len(captions) != len(images):
        raise ShapeError(f"captions must be as many as images ({len(images)}), got {len(captions)}.")
    height, width = images[0].shape[:2]
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    row_height = height + gap + (caption_height if captions else 0)
    sheet = Image.new("RGB", (columns * (width + gap) + gap, rows * row_height + gap), background)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=max(10, int(caption_height * 0.62)))
    for k, image in enumerate(images):
        left, top = gap + (k % columns) * (width + gap), gap + (k // columns) * row_height
        sheet.paste(Image.fromarray(np.ascontiguousarray(image)), (left, top))
        if captions:
            middle = (left + width // 2, top + height + caption_height // 2)
            draw.text(middle, captions[k], fill=(40, 40, 45), font=font, anchor="mm")
    return np.asarray(sheet)
