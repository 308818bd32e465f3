"""What an operations centre may demand beyond the contract: each option off by default, each priced in the report."""
