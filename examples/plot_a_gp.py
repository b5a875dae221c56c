"""Draw a Gaussian process on five observations, with three draws and the expected improvement."""

import bojax
from bojax.models.gaussian_process import GaussianProcess

gp = GaussianProcess.fit("matern52", 0.01, [-1.0, -0.6, -0.2, 0.3, 1.2], [0.0, 0.8, 1.0, 0.7, -1.0])
picture = bojax.plot_gp(gp, low=-2, high=2, samples=3, acquisition="ei")
picture.figure.savefig("gp.png")
print(picture.caption)
