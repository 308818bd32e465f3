"""Plans made of recordings: minimum lengths, mode switches, command budgets and pointings."""
