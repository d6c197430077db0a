"""Hidden-effects study: an independent simulator hides effects in campaigns, and the learning loop must find them."""
