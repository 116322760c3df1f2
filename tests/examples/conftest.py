"""What tests of the examples share with those of the product."""

from tests.hybrid.conftest import little_work  # noqa: F401  (a fixture)
