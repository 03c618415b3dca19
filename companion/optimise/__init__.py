"""How to search: optimisers of the unit cube that have never heard of aeroplanes."""
