"""Plans to compare with: greedy by reward, and today's manual practice."""
