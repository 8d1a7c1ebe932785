#include "coordinator/journal/postgres_journal.h"

#include <libpq-fe.h>

#include <charconv>
#include <chrono>
#include <cstdlib>
#include <deque>
#include <span>
#include <thread>
#include <utility>

#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::coordinator {

namespace {

constexpr std::uint64_t layout = 1;
constexpr const char* lock_number = "7452451";  // of the advisory lock that the coordinator at work holds
constexpr std::chrono::milliseconds between_tries{200};

// As sqlite_journal.cpp's. A write whose outcome was lost with the connection is done again: it must do no harm twice.
constexpr const char* schema = R"(
CREATE SCHEMA gleaner;
CREATE TABLE gleaner.meta(layout BIGINT NOT NULL, starts BIGINT NOT NULL);
INSERT INTO gleaner.meta VALUES(1, 0);
CREATE TABLE gleaner.jobs(place BIGSERIAL PRIMARY KEY, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL,
                          message BYTEA NOT NULL, submitted DOUBLE PRECISION NOT NULL, ended DOUBLE PRECISION NOT NULL,
                          worker_seconds DOUBLE PRECISION NOT NULL, rays BIGINT NOT NULL);
CREATE TABLE gleaner.requests(id TEXT PRIMARY KEY, request BYTEA NOT NULL, frames BYTEA NOT NULL);
CREATE TABLE gleaner.frames_over(job TEXT NOT NULL, frame BIGINT NOT NULL, failure BYTEA NOT NULL,
                                 PRIMARY KEY(job, frame));
CREATE TABLE gleaner.ranges(job TEXT NOT NULL, frame BIGINT NOT NULL, artifact TEXT NOT NULL, first BIGINT NOT NULL,
                            count BIGINT NOT NULL, place BIGINT NOT NULL, bytes BIGINT NOT NULL, digest BYTEA NOT NULL,
                            facts BYTEA NOT NULL, PRIMARY KEY(job, frame, artifact, first));
)";

struct FreeResult {
  void operator()(PGresult* result) const { PQclear(result); }
};

// Rows of an answer.
class Rows {
 public:
  explicit Rows(PGresult* result) : result_(result) {}
  int count() const { return PQntuples(result_.get()); }
  std::string text(int row, int column) const {
    return {PQgetvalue(result_.get(), row, column), static_cast<std::size_t>(PQgetlength(result_.get(), row, column))};
  }
  std::string bytes(int row, int column) const {
    std::size_t size = 0;
    const std::unique_ptr<unsigned char, decltype(&PQfreemem)> plain(
        PQunescapeBytea(reinterpret_cast<const unsigned char*>(PQgetvalue(result_.get(), row, column)), &size),
        PQfreemem);
    if (!plain) throw std::bad_alloc();
    return {reinterpret_cast<const char*>(plain.get()), size};
  }
  Bytes blob(int row, int column) const {
    const std::string all = bytes(row, column);
    const auto span = std::as_bytes(std::span(all));
    return {span.begin(), span.end()};
  }
  std::uint64_t number(int row, int column) const {
    return static_cast<std::uint64_t>(std::strtoll(PQgetvalue(result_.get(), row, column), nullptr, 10));
  }
  double real(int row, int column) const { return std::strtod(PQgetvalue(result_.get(), row, column), nullptr); }

 private:
  std::unique_ptr<PGresult, FreeResult> result_;
};

// The values of a statement, $1 first.
class Values {
 public:
  Values& text(const std::string& value) { return add(value, false); }
  Values& bytes(std::string value) { return add(std::move(value), true); }
  Values& bytes(const Bytes& value) { return add({reinterpret_cast<const char*>(value.data()), value.size()}, true); }
  Values& number(std::uint64_t value) { return add(std::to_string(static_cast<std::int64_t>(value)), false); }
  Values& real(double value) {
    char digits[64];  // the shortest that stand for this number
    const auto end = std::to_chars(digits, digits + sizeof digits, value).ptr;
    return add({digits, end}, false);
  }

 private:
  friend class PostgresJournal;
  Values& add(std::string value, bool binary) {
    values_.push_back(std::move(value));
    pointers_.push_back(values_.back().c_str());
    lengths_.push_back(static_cast<int>(values_.back().size()));
    formats_.push_back(binary);
    return *this;
  }

  std::deque<std::string> values_;  // which stay where they are
  std::vector<const char*> pointers_;
  std::vector<int> lengths_, formats_;
};

class PostgresJournal final : public Journal {
 public:
  PostgresJournal(const std::string& address, double patience) : address_(address) {
    const auto until = std::chrono::steady_clock::now() + std::chrono::duration<double>(patience);
    for (;;) {
      try {
        connect();
        break;
      } catch (const Error&) {
        if (std::chrono::steady_clock::now() >= until) throw;
      }
      std::this_thread::sleep_for(between_tries);
    }
    open();
  }

  std::string name() const override { return name_; }

  std::uint64_t begin() override {
    return ask("UPDATE gleaner.meta SET starts = starts + 1 RETURNING starts").number(0, 0) & 0xffffffff;
  }

  std::vector<JournalJob> jobs() override {
    const Rows rows =
        ask("SELECT jobs.id, state, message, submitted, ended, worker_seconds, rays, request FROM gleaner.jobs "
            "JOIN gleaner.requests ON requests.id = jobs.id ORDER BY place");
    std::vector<JournalJob> all;
    for (int i = 0; i < rows.count(); ++i)
      all.push_back({.id = rows.text(i, 0),
                     .state = rows.text(i, 1),
                     .message = rows.bytes(i, 2),
                     .submitted = rows.real(i, 3),
                     .ended = rows.real(i, 4),
                     .worker_seconds = rows.real(i, 5),
                     .rays = rows.number(i, 6),
                     .request = rows.blob(i, 7)});
    return all;
  }

  Bytes frames(const std::string& job) override {
    const Rows rows = ask("SELECT frames FROM gleaner.requests WHERE id = $1", Values().text(job));
    return rows.count() > 0 ? rows.blob(0, 0) : Bytes();
  }

  std::vector<JournalFrame> frames_over(const std::string& job) override {
    const Rows rows =
        ask("SELECT frame, failure FROM gleaner.frames_over WHERE job = $1 ORDER BY frame", Values().text(job));
    std::vector<JournalFrame> all;
    for (int i = 0; i < rows.count(); ++i)
      all.push_back({.job = job, .frame = rows.number(i, 0), .failure = rows.bytes(i, 1)});
    return all;
  }

  std::vector<JournalRange> ranges(const std::string& job, std::uint64_t frame) override {
    const Rows rows = ask(
        "SELECT artifact, first, count, place, bytes, digest, facts FROM gleaner.ranges WHERE job = $1 AND frame = $2 "
        "ORDER BY artifact, first",
        Values().text(job).number(frame));
    std::vector<JournalRange> all;
    for (int i = 0; i < rows.count(); ++i)
      all.push_back({.job = job,
                     .frame = frame,
                     .artifact = rows.text(i, 0),
                     .first = rows.number(i, 1),
                     .count = rows.number(i, 2),
                     .offset = rows.number(i, 3),
                     .bytes = rows.number(i, 4),
                     .digest = rows.bytes(i, 5),
                     .facts = rows.blob(i, 6)});
    return all;
  }

  void add(const JournalJob& job, const Bytes& frames) override {
    transaction([&] {
      run("INSERT INTO gleaner.jobs(id, state, message, submitted, ended, worker_seconds, rays) "
          "VALUES($1, $2, $3, $4, $5, $6, $7)",
          Values()
              .text(job.id)
              .text(job.state)
              .bytes(job.message)
              .real(job.submitted)
              .real(job.ended)
              .real(job.worker_seconds)
              .number(job.rays));
      run("INSERT INTO gleaner.requests(id, request, frames) VALUES($1, $2, $3)",
          Values().text(job.id).bytes(job.request).bytes(frames));
    });
  }

  void write(const JournalChanges& changes) override {
    transaction([&] {
      write_frames(changes);
      write_ranges(changes);
      write_jobs(changes);  // takes out what was forgotten
    });
  }

 private:
  struct Finish {
    void operator()(PGconn* connection) const { PQfinish(connection); }
  };

  // Throws Error::failed where nobody answers, or another coordinator is at work.
  void connect() {
    // The address comes last: what it says of the others counts.
    const char* const keys[] = {"application_name", "connect_timeout", "tcp_user_timeout", "dbname", nullptr};
    const char* const values[] = {"gleaner-coordinator", "5", "10000", address_.c_str(), nullptr};
    connection_.reset(PQconnectdbParams(keys, values, 1));
    if (!connection_) throw std::bad_alloc();
    // What it is called must not hold its password.
    const auto word = [](const char* text) { return std::string(text ? text : ""); };
    name_ = printable("postgresql://" + word(PQhost(connection_.get())) + ":" + word(PQport(connection_.get())) + "/" +
                      word(PQdb(connection_.get())));
    if (PQstatus(connection_.get()) != CONNECTION_OK) fail(PQerrorMessage(connection_.get()));
    PQsetNoticeProcessor(
        connection_.get(), [](void*, const char*) {}, nullptr);
    // A job whose id was told must not be lost with the power.
    run("SET synchronous_commit = on");
    run("SET client_min_messages = warning");
    if (run(std::string("SELECT pg_try_advisory_lock(") + lock_number + ")").text(0, 0) != "t") {
      connection_.reset();
      throw Error::failed("journal " + name_ + ": another coordinator is at work on it");
    }
  }

  void open() {
    if (run("SELECT 1 FROM pg_catalog.pg_namespace WHERE nspname = 'gleaner'").count() == 0)
      transaction([&] { execute(schema); });
    const Rows meta = run("SELECT layout FROM gleaner.meta");
    const std::uint64_t found = meta.count() > 0 ? meta.number(0, 0) : 0;
    if (found != layout)
      throw Error::failed("journal " + name_ + ": it was written by another version of Gleaner (layout " +
                          std::to_string(found) + ", this one knows " + std::to_string(layout) + ")");
  }

  void write_jobs(const JournalChanges& changes) {
    for (const auto& [id, job] : changes.jobs)
      run("UPDATE gleaner.jobs SET state = $1, message = $2, ended = $3, worker_seconds = $4, rays = $5 WHERE id = $6",
          Values()
              .text(job.state)
              .bytes(job.message)
              .real(job.ended)
              .real(job.worker_seconds)
              .number(job.rays)
              .text(id));
    for (const std::string& id : changes.forgotten)
      for (const char* text :
           {"DELETE FROM gleaner.jobs WHERE id = $1", "DELETE FROM gleaner.requests WHERE id = $1",
            "DELETE FROM gleaner.frames_over WHERE job = $1", "DELETE FROM gleaner.ranges WHERE job = $1"})
        run(text, Values().text(id));
  }

  void write_frames(const JournalChanges& changes) {
    for (const std::string& job : changes.retried)
      run("DELETE FROM gleaner.frames_over WHERE job = $1 AND length(failure) > 0", Values().text(job));
    for (const JournalFrame& frame : changes.frames_over)
      run("INSERT INTO gleaner.frames_over(job, frame, failure) VALUES($1, $2, $3) "
          "ON CONFLICT(job, frame) DO UPDATE SET failure = excluded.failure",
          Values().text(frame.job).number(frame.frame).bytes(frame.failure));
  }

  void write_ranges(const JournalChanges& changes) {
    for (const auto& [job, frame] : changes.dropped_frames)
      run("DELETE FROM gleaner.ranges WHERE job = $1 AND frame = $2", Values().text(job).number(frame));
    for (const std::string& job : changes.dropped_jobs)
      run("DELETE FROM gleaner.ranges WHERE job = $1", Values().text(job));
    for (const JournalRange& range : changes.ranges)
      run("INSERT INTO gleaner.ranges(job, frame, artifact, first, count, place, bytes, digest, facts) "
          "VALUES($1, $2, $3, $4, $5, $6, $7, $8, $9) ON CONFLICT(job, frame, artifact, first) DO UPDATE SET "
          "count = excluded.count, place = excluded.place, bytes = excluded.bytes, digest = excluded.digest, "
          "facts = excluded.facts",
          Values()
              .text(range.job)
              .number(range.frame)
              .text(range.artifact)
              .number(range.first)
              .number(range.count)
              .number(range.offset)
              .number(range.bytes)
              .bytes(range.digest)
              .bytes(range.facts));
  }

  // --- One statement, one call

  Rows run(const std::string& statement, const Values& values = {}) {
    return checked(PQexecParams(connection_.get(), statement.c_str(), static_cast<int>(values.values_.size()), nullptr,
                                values.pointers_.data(), values.lengths_.data(), values.formats_.data(), 0));
  }
  void execute(const char* statements) { checked(PQexec(connection_.get(), statements)); }

  Rows checked(PGresult* result) {
    Rows rows(result);
    const ExecStatusType status = PQresultStatus(result);
    if (status != PGRES_COMMAND_OK && status != PGRES_TUPLES_OK)
      fail(result ? PQresultErrorMessage(result) : PQerrorMessage(connection_.get()));
    return rows;
  }

  [[noreturn]] void fail(std::string reason) {
    for (char& letter : reason)
      if (letter == '\n' || letter == '\t') letter = ' ';
    while (reason.ends_with(' ')) reason.pop_back();
    throw Error::failed("journal " + name_ + ": " + printable(reason));
  }

  // A connection that was lost is made again. What was lost with it is not asked again here.
  void ensure_connection() {
    if (!connection_ || PQstatus(connection_.get()) != CONNECTION_OK) connect();
  }
  Rows ask(const std::string& statement, const Values& values = {}) {
    ensure_connection();
    return run(statement, values);
  }

  template <typename Call>
  void transaction(const Call& call) {
    ensure_connection();
    execute("BEGIN");
    try {
      call();
      execute("COMMIT");
    } catch (...) {
      PQclear(PQexec(connection_.get(), "ROLLBACK"));  // of a connection that is lost: the server does it
      throw;
    }
  }

  const std::string address_;
  std::string name_;
  std::unique_ptr<PGconn, Finish> connection_;
};

}  // namespace

std::unique_ptr<Journal> open_postgres_journal(const std::string& address, double patience) {
  return std::make_unique<PostgresJournal>(address, patience);
}

}  // namespace gleaner::coordinator
