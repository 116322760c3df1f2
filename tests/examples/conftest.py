"""What tests of the examples share with those of the product."""

from tests.hybrid.conftest import small_caches  # noqa: F401  (a fixture)
