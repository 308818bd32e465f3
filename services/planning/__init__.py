"""Planning: which satellite-seconds to record and when to downlink them (data-cycle MILP to exact schedule)."""
