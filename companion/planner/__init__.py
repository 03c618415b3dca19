"""When and what to plan: guidance, one plan, and the online procedure (paper 2.3, 2.6)."""
