#pragma once
// OpenSSL's objects, released.

#include <openssl/bio.h>
#include <openssl/bn.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <memory>
#include <string>
#include <string_view>

#include "scene/model/error.h"

namespace gleaner::openssl {

struct Release {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(X509_EXTENSION* extension) const { X509_EXTENSION_free(extension); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  void operator()(BIGNUM* number) const { BN_free(number); }
};
template <typename T>
using Held = std::unique_ptr<T, Release>;

// Null where the text is none.
inline Held<X509> parse_certificate(std::string_view pem) {
  const Held<BIO> bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  return Held<X509>(bio ? PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr) : nullptr);
}
inline Held<EVP_PKEY> parse_key(std::string_view pem) {
  const Held<BIO> bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  return Held<EVP_PKEY>(bio ? PEM_read_bio_PrivateKey(bio.get(), nullptr, nullptr, nullptr) : nullptr);
}

// What write(BIO*) writes. Throws Error::failed where it does not return 1.
template <typename Write>
std::string pem_of(Write&& write) {
  const Held<BIO> bio(BIO_new(BIO_s_mem()));
  if (!bio || write(bio.get()) != 1) throw Error::failed("OpenSSL: writing PEM failed");
  char* bytes = nullptr;
  const long size = BIO_get_mem_data(bio.get(), &bytes);
  return {bytes, static_cast<std::size_t>(size)};
}

inline std::string hexadecimal(const BIGNUM& number) {
  char* text = BN_bn2hex(&number);
  const std::string copy = text ? text : "";
  OPENSSL_free(text);
  return copy;
}
// Hexadecimal.
inline std::string serial_of(X509* certificate) {
  const Held<BIGNUM> number(ASN1_INTEGER_to_BN(X509_get0_serialNumber(certificate), nullptr));
  return number ? hexadecimal(*number) : std::string();
}

}  // namespace gleaner::openssl
