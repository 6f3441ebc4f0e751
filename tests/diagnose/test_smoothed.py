"""The smoothing of recorded signals: that of Savitzky and Golay."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from twin.diagnose.force_balance import smoothed


@pytest.mark.parametrize("window", [7, 21])
@pytest.mark.parametrize("derivative", [False, True])
def test_signals_are_smoothed_by_parabolas_up_to_their_ends(window: int, derivative: bool) -> None:
    values = np.cumsum(np.random.default_rng(0).standard_normal(200))
    np.testing.assert_allclose(smoothed(values, window, derivative), savgol_filter(values, window, 2, deriv=int(derivative)), atol=1e-11)
