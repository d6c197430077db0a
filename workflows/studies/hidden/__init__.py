"""Hidden-effect campaigns: an independent simulator hides effects, the loop has to find them."""
