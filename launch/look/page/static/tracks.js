/** The last seconds of every trace: rings of buckets with two values each, in the form that the server sends. */

export class Track {
  constructor(facts, buckets) {
    Object.assign(this, facts); // node, topic, symbol, columns with their units, and the seconds of a bucket
    this.buckets = buckets;
    this.begin = this.end = 0; // numbers of the first kept bucket, and of the one after the latest
    this.rings = facts.columns.map(() => new Float64Array(2 * buckets).fill(NaN));
  }

  /** Add buckets from `first` on: for each column a list of values, two for each bucket. */
  add([first, columns]) {
    const count = columns.length ? columns[0].length / 2 : 0;
    if (this.end === 0 || first > this.end + this.buckets || first + count < this.begin) {
      for (const ring of this.rings) ring.fill(NaN);
      this.begin = this.end = first;
    }
    this.rings.forEach((ring, c) => {
      for (let b = this.end; b < first; b += 1) {
        const place = 2 * (b % this.buckets);
        ring[place] = ring[place + 1] = NaN;
      }
      for (let i = 0; i < count; i += 1) {
        const place = 2 * ((first + i) % this.buckets);
        ring[place] = columns[c][2 * i] ?? NaN;
        ring[place + 1] = columns[c][2 * i + 1] ?? NaN;
      }
    });
    this.end = first + count;
    this.begin = Math.max(this.begin, this.end - this.buckets);
  }

  /** One of the two values of a bucket; NaN where there is no value. */
  value(column, bucket, half) {
    if (bucket < this.begin || bucket >= this.end) return NaN;
    return this.rings[column][2 * (bucket % this.buckets) + half];
  }

  /** The value at a bucket (a fraction lies between two), or the last one before it. */
  at(column, bucket) {
    const last = Math.min(Math.floor(bucket), this.end - 1);
    for (let b = last; b >= this.begin && b > last - 60; b -= 1) {
      const here = this.middle(column, b);
      if (Number.isNaN(here)) continue;
      const next = this.middle(column, b + 1);
      const part = Math.min(Math.max(bucket - b, 0), 1);
      return Number.isNaN(next) ? here : here + part * (next - here);
    }
    return NaN;
  }

  middle(column, bucket) {
    return (this.value(column, bucket, 0) + this.value(column, bucket, 1)) / 2;
  }

  /** The greatest magnitude of a column's values in the last `buckets` buckets. */
  most(column, buckets) {
    let most = 0;
    for (let b = Math.max(this.begin, this.end - buckets); b < this.end; b += 1) {
      for (const half of [0, 1]) {
        const size = Math.abs(this.value(column, b, half));
        if (size > most) most = size;
      }
    }
    return most;
  }
}
