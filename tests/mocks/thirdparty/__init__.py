"""Mock packages that are no part of the product, as a third party would write them."""
