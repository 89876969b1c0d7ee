"""Numbers to learn from are finite, or the first that is not is named."""

from collections.abc import Sequence

import numpy as np

from playlearn.episode import Array
from playlearn.errors import StoreError


def check_finite(values: Array, names: Sequence[str], where: str) -> None:
    """Raises StoreError that names the first row and dimension of (n, ..., D) that is NaN or infinite.

    names: (D,).
    where: the file, or the store, episode and array.
    """
    finite = np.isfinite(values)
    if finite.all():
        return
    at = tuple(np.argwhere(~finite)[0])
    raise StoreError(
        f"{where}: {names[at[-1]]} is {values[at]} in row {at[0]}; training needs finite numbers: mend them there, or "
        "leave this episode out"
    )
