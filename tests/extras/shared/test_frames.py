"""Places on Earth and on the tangential plane."""

import numpy as np

from mavfi.extras.shared.frames import geodetic, local


def test_geodetic_and_back():
    ned = np.array([120.0, -45.0, -7.0])
    np.testing.assert_allclose(local(*geodetic(ned)), ned, atol=1e-6)
